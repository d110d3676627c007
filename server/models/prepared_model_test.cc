// SPDX-License-Identifier: Apache-2.0
#include "server/models/prepared_model.h"

#include "core/models/cube_files_testing.h"
#include "evpose/storage/v1/model.pb.h"
#include "gtest/gtest.h"

namespace evpose::server {
namespace {

ObjectModel PreparedCube() {
  const std::string obj = Cube();
  return ParseObjectModel({reinterpret_cast<const uint8_t*>(obj.data()), obj.size()}, ModelFormat::kObj,
                          {.metres_per_unit = 0.1})
      .value();
}

TEST(PreparedModelTest, ComesBackToTheBit) {
  const ObjectModel cube = PreparedCube();
  const ObjectModel decoded = DecodePreparedModel(EncodePreparedModel(cube)).value();
  EXPECT_EQ(decoded.vertices, cube.vertices);
  EXPECT_EQ(decoded.triangles, cube.triangles);
  EXPECT_EQ(decoded.diameter_m, cube.diameter_m);
  EXPECT_EQ(decoded.notices, cube.notices);
  ASSERT_EQ(decoded.lines.size(), 12u);
  for (size_t i = 0; i < decoded.lines.size(); ++i) {
    EXPECT_EQ(decoded.lines[i].p1, cube.lines[i].p1);
    EXPECT_EQ(decoded.lines[i].p2, cube.lines[i].p2);
    EXPECT_EQ(decoded.lines[i].face_normals, cube.lines[i].face_normals);
  }
  ASSERT_EQ(decoded.symmetries.size(), 24u);
  for (size_t i = 0; i < decoded.symmetries.size(); ++i) {
    EXPECT_EQ(decoded.symmetries[i].rotation, cube.symmetries[i].rotation);
    EXPECT_EQ(decoded.symmetries[i].translation_m, cube.symmetries[i].translation_m);
  }
}

// A model with two of everything that a cube does not have.
ObjectModel CurvedModel() {
  ObjectModel model = PreparedCube();
  model.lines[2].kind = EdgeKind::kPainted;
  model.curves.resize(2);
  model.curves[0] = {EdgeKind::kBoundary,
                     {{0.1, 0.2, 0.3}, {1.0 / 3.0, 0.0, 0.0}, {0.1, 0.2, 0.3}},
                     {{{{0, 0, 1}, {0, 0, 0}}}, {{{0, 1, 0}, {0, 0, 0}}}},
                     0.0};
  model.curves[1] = {EdgeKind::kCrease, {{1, 2, 3}, {4, 5, 6}}, {{{{1, 0, 0}, {0, 1, 0}}}}, 0.7};
  model.surface.regions.resize(2);
  model.surface.regions[0] = {RegionShape::kPlane, {0, 0, 0.1}, {0, 0, 1}, 0.0, 0.0, true};
  model.surface.regions[1] = {RegionShape::kCone, {0.3, 0, 0}, {1, 0, 0}, 0.25, 0.125, false};
  for (size_t t = 0; t < model.triangles.size(); ++t) {
    model.surface.region_of.push_back(t % 2);
    const float number = 1.0f / static_cast<float>(t + 3);
    model.surface.normals.push_back({Eigen::Vector3f(number, 0, 1), {0, number, 2}, {3, 4, number}});
  }
  model.facet_edges = {{0, 3}, {5, 7}};
  model.symmetries.clear();
  model.continuous_symmetry = {ContinuousSymmetry::Kind::kAxis, {0.1, 0, 0}, {0, 1, 0}, true};
  return model;
}

TEST(PreparedModelTest, CurvesAndSurfaceComeBackToTheBit) {
  const ObjectModel model = CurvedModel();
  const ObjectModel decoded = DecodePreparedModel(EncodePreparedModel(model)).value();
  EXPECT_EQ(decoded.lines[2].kind, EdgeKind::kPainted);
  EXPECT_EQ(decoded.lines[3].kind, EdgeKind::kCrease);
  ASSERT_EQ(decoded.curves.size(), 2u);
  for (size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(decoded.curves[i].kind, model.curves[i].kind);
    EXPECT_EQ(decoded.curves[i].points, model.curves[i].points);
    EXPECT_EQ(decoded.curves[i].face_normals, model.curves[i].face_normals);
    EXPECT_EQ(decoded.curves[i].turn_rad, model.curves[i].turn_rad);
  }
  EXPECT_TRUE(decoded.curves[0].is_ring());
  EXPECT_EQ(decoded.facet_edges, model.facet_edges);
  EXPECT_EQ(decoded.surface.region_of, model.surface.region_of);
  EXPECT_EQ(decoded.surface.normals, model.surface.normals);
  ASSERT_EQ(decoded.surface.regions.size(), 2u);
  for (size_t i = 0; i < 2; ++i) {
    const SurfaceRegion &back = decoded.surface.regions[i], &region = model.surface.regions[i];
    EXPECT_EQ(back.shape, region.shape);
    EXPECT_EQ(back.point, region.point);
    EXPECT_EQ(back.axis, region.axis);
    EXPECT_EQ(back.radius_m, region.radius_m);
    EXPECT_EQ(back.half_angle_rad, region.half_angle_rad);
    EXPECT_EQ(back.is_convex, region.is_convex);
  }
  ASSERT_TRUE(decoded.continuous_symmetry.has_value());
  EXPECT_EQ(decoded.continuous_symmetry->kind, ContinuousSymmetry::Kind::kAxis);
  EXPECT_EQ(decoded.continuous_symmetry->centre, model.continuous_symmetry->centre);
  EXPECT_EQ(decoded.continuous_symmetry->axis, model.continuous_symmetry->axis);
  EXPECT_TRUE(decoded.continuous_symmetry->is_flippable);
}

TEST(PreparedModelTest, RefusesPartsOfASurface) {
  const auto is_refused = [](const ObjectModel& model) {
    return absl::IsDataLoss(DecodePreparedModel(EncodePreparedModel(model)).status());
  };
  ObjectModel model = CurvedModel();
  model.surface.region_of[5] = 2;
  EXPECT_TRUE(is_refused(model)) << "a region that does not exist";
  model = CurvedModel();
  model.facet_edges[1][0] = static_cast<uint32_t>(3 * model.triangles.size());
  EXPECT_TRUE(is_refused(model)) << "a side that does not exist";
  model = CurvedModel();
  model.surface.normals.pop_back();
  EXPECT_TRUE(is_refused(model)) << "a triangle without normals";
  model = CurvedModel();
  model.surface.regions.clear();
  EXPECT_TRUE(is_refused(model)) << "normals without regions";
  model = CurvedModel();
  model.curves[0].points.pop_back();
  EXPECT_TRUE(is_refused(model)) << "normals without a segment";
  model = CurvedModel();
  model.curves[1].kind = EdgeKind::kContour;
  EXPECT_TRUE(is_refused(model)) << "a contour, which belongs to a view";
}

SearchViews SomeViews() {
  SearchViews views;
  views.templates = {{{{0.1, 1.0 / 3.0, -0.2}, {1e-9, 0.0, -0.7}, 0.8f}, {{1, 2, 3}, {4, 5, 6}, 1.0f / 3.0f}}, {}};
  views.lines = {{}, {{3, 0.0, 1.0, 0.25}, {7, 1.0 / 3.0, 2.0 / 3.0, 0.0}}, {{0, 0.5, 1.0, 1.0}}};
  return views;
}

TEST(PreparedModelTest, ViewsComeBackToTheBit) {
  ObjectModel model = CurvedModel();
  EXPECT_EQ(DecodePreparedModel(EncodePreparedModel(model))->views, nullptr);
  const std::string appended = EncodePreparedModel(model) + EncodePreparedViews(SomeViews());
  model.views = std::make_shared<const SearchViews>(SomeViews());
  EXPECT_EQ(appended, EncodePreparedModel(model));
  const ObjectModel decoded = DecodePreparedModel(appended).value();
  ASSERT_NE(decoded.views, nullptr);
  EXPECT_EQ(decoded.views->templates, model.views->templates);
  EXPECT_EQ(decoded.views->lines, model.views->lines);
  EXPECT_EQ(decoded.vertices, model.vertices);
  EXPECT_EQ(decoded.curves.size(), model.curves.size());
}

TEST(PreparedModelTest, RefusesPartsOfViews) {
  const auto is_refused = [](void (*change)(storage::v1::SearchViews&)) {
    storage::v1::PreparedModel stored;
    EXPECT_TRUE(stored.ParseFromString(EncodePreparedModel(PreparedCube()) + EncodePreparedViews(SomeViews())));
    change(*stored.mutable_views());
    return absl::IsDataLoss(DecodePreparedModel(stored.SerializeAsString()).status());
  };
  EXPECT_FALSE(is_refused([](auto&) {}));
  EXPECT_TRUE(is_refused([](auto& views) { views.mutable_template_samples()->RemoveLast(); }));
  EXPECT_TRUE(is_refused([](auto& views) { views.mutable_template_contrasts()->RemoveLast(); }));
  EXPECT_TRUE(is_refused([](auto& views) { views.set_template_sizes(0, 0xffffffffu); }));
  EXPECT_TRUE(is_refused([](auto& views) { views.mutable_line_view_sizes()->RemoveLast(); }));
  EXPECT_TRUE(is_refused([](auto& views) { views.add_view_lines(1); }));
  EXPECT_TRUE(is_refused([](auto& views) { views.add_view_parts(1.0); }));
  EXPECT_TRUE(is_refused([](auto& views) { views.mutable_template_sizes()->Resize(100'000, 0); }));
  EXPECT_TRUE(is_refused([](auto& views) { views.mutable_line_view_sizes()->Resize(100'000, 0); }));
}

TEST(PreparedModelTest, AContinuousSymmetryComesBackToTheBit) {
  ObjectModel model = PreparedCube();
  EXPECT_FALSE(DecodePreparedModel(EncodePreparedModel(model))->continuous_symmetry.has_value());
  for (const auto kind : {ContinuousSymmetry::Kind::kAxis, ContinuousSymmetry::Kind::kSphere}) {
    model.continuous_symmetry = {
        kind, {0.1, -0.2, 1.0 / 3.0}, {0.0, 0.6, 0.8}, kind == ContinuousSymmetry::Kind::kAxis};
    const ObjectModel decoded = DecodePreparedModel(EncodePreparedModel(model)).value();
    ASSERT_TRUE(decoded.continuous_symmetry.has_value());
    EXPECT_EQ(decoded.continuous_symmetry->kind, kind);
    EXPECT_EQ(decoded.continuous_symmetry->centre, model.continuous_symmetry->centre);
    EXPECT_EQ(decoded.continuous_symmetry->axis, model.continuous_symmetry->axis);
    EXPECT_EQ(decoded.continuous_symmetry->is_flippable, model.continuous_symmetry->is_flippable);
  }
}

TEST(PreparedModelTest, RefusesIndicesOutOfRangeAndOtherBytes) {
  ObjectModel cube = PreparedCube();
  cube.triangles[3][1] = static_cast<uint32_t>(cube.vertices.size());
  EXPECT_TRUE(absl::IsDataLoss(DecodePreparedModel(EncodePreparedModel(cube)).status()));
  EXPECT_TRUE(absl::IsDataLoss(DecodePreparedModel("no model").status()));
}

}  // namespace
}  // namespace evpose::server
