// SPDX-License-Identifier: Apache-2.0
#include "core/models/visibility.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>
#include <set>

#include "absl/strings/str_format.h"
#include "core/models/view_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

ObjectModel Model(const std::string& obj) {
  auto model = ParseObjectModel({reinterpret_cast<const uint8_t*>(obj.data()), obj.size()}, ModelFormat::kObj, {});
  EXPECT_TRUE(model.ok()) << model.status();
  return *std::move(model);
}

// A box around `centre`; vertex numbers start after `first`.
std::string Box(const Eigen::Vector3d& centre, const Eigen::Vector3d& size, int first = 0) {
  std::string obj;
  for (const int z : {-1, 1}) {
    for (const auto& [x, y] : {std::pair(-1, -1), std::pair(1, -1), std::pair(1, 1), std::pair(-1, 1)}) {
      absl::StrAppendFormat(&obj, "v %g %g %g\n", centre.x() + x * size.x() / 2, centre.y() + y * size.y() / 2,
                            centre.z() + z * size.z() / 2);
    }
  }
  for (const auto& [a, b, c, d] : {std::array{1, 4, 3, 2}, std::array{5, 6, 7, 8}, std::array{1, 2, 6, 5},
                                   std::array{2, 3, 7, 6}, std::array{3, 4, 8, 7}, std::array{4, 1, 5, 8}}) {
    absl::StrAppendFormat(&obj, "f %d %d %d %d\n", a + first, b + first, c + first, d + first);
  }
  return obj;
}

std::string CentredCube() { return Box({0, 0, 0}, {0.15, 0.15, 0.15}); }

CameraModel Camera() { return {1280, 720, 1000.0, 1000.0, 640.0, 360.0, {}}; }

std::vector<VisibleSegment> See(const ObjectModel& model, const RigidTransform& pose,
                                const VisibilityOptions& options = {}, const CameraModel& camera = Camera()) {
  const auto segments = VisibilityTester(model, options).VisibleSegments(camera, pose);
  for (size_t i = 0; i < segments.size(); ++i) {
    EXPECT_LE(0.0, segments[i].begin);
    EXPECT_LT(segments[i].begin, segments[i].end);
    EXPECT_LE(segments[i].end, 1.0);
    if (i > 0) {
      EXPECT_LT(std::pair(segments[i - 1].line, segments[i - 1].end), std::pair(segments[i].line, segments[i].begin));
    }
  }
  return segments;
}

Eigen::Vector3d Middle(const ModelLine& line) { return 0.5 * (line.p1 + line.p2); }

// Segments of the line through `middle`.
std::vector<VisibleSegment> Of(const std::vector<VisibleSegment>& segments, const ObjectModel& model,
                               const Eigen::Vector3d& middle) {
  std::vector<VisibleSegment> found;
  for (const VisibleSegment& segment : segments) {
    if ((Middle(model.lines[segment.line]) - middle).norm() < 1e-6) found.push_back(segment);
  }
  return found;
}

TEST(VisibilityTest, CubeShowsOneTwoOrThreeFaces) {
  const ObjectModel cube = Model(CentredCube());
  EXPECT_THAT(See(cube, ViewFrom({0, 0, 0.8})), SizeIs(4));
  EXPECT_THAT(See(cube, ViewFrom({0.5, 0, 0.6})), SizeIs(7));
  EXPECT_THAT(See(cube, ViewFrom({0.4, 0.3, 0.6})), SizeIs(9));
  for (const VisibleSegment& segment : See(cube, ViewFrom({0.4, 0.3, 0.6}))) {
    EXPECT_EQ(segment.begin, 0.0);
    EXPECT_EQ(segment.end, 1.0);
  }
}

TEST(VisibilityTest, CubeFromAnywhereShowsTheEdgesOfTheFacesTurnedToTheCamera) {
  const ObjectModel cube = Model(CentredCube());
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 300; ++trial) {
    const Eigen::Vector3d eye = 0.8 * Eigen::Vector3d(normal(random), normal(random), normal(random)).normalized();
    // Outside of the grazing range, in which both results are right.
    if (((eye.cwiseAbs().array() - 0.075).abs() < 0.05).any()) continue;
    std::set<int> expected, seen;
    for (size_t i = 0; i < cube.lines.size(); ++i) {
      for (const Eigen::Vector3d& n : cube.lines[i].face_normals) {
        if (n.dot(eye) > 0.075) expected.insert(static_cast<int>(i));
      }
    }
    for (const VisibleSegment& segment : See(cube, ViewFrom(eye))) {
      seen.insert(segment.line);
      EXPECT_EQ(segment.end - segment.begin, 1.0);
    }
    EXPECT_EQ(seen, expected) << eye.transpose();
  }
}

TEST(VisibilityTest, SecondBoxHidesPartOfTheFirst) {
  // A box 0.1 m in front of the cube's face hides its right half, as seen from (0, 0, 1).
  const ObjectModel model = Model(CentredCube() + Box({0.1, 0, 0.175}, {0.2, 0.6, 0.02}, 8));
  const auto segments = See(model, ViewFrom({0, 0, 1}));
  // The ray that grazes the box's edge x = 0 at its front runs straight on to x = 0.
  for (const double y : {-0.075, 0.075}) {
    const auto horizontal = Of(segments, model, {0, y, 0.075});
    ASSERT_THAT(horizontal, SizeIs(1));
    EXPECT_NEAR(horizontal[0].end - horizontal[0].begin, 0.5, 1e-3);
    const ModelLine& line = model.lines[horizontal[0].line];
    const double middle = 0.5 * (horizontal[0].begin + horizontal[0].end);
    EXPECT_NEAR((line.p1 + middle * (line.p2 - line.p1)).x(), -0.0375, 1e-3);
  }
  EXPECT_THAT(Of(segments, model, {0.075, 0, 0.075}), IsEmpty());
  EXPECT_THAT(Of(segments, model, {-0.075, 0, 0.075}), SizeIs(1));
}

// A plate with a raised part of 5 mm: from the front both have the same brightness, and from the side the wall shows.
TEST(VisibilityTest, AStepSeenFromTheFrontHasParallelSides) {
  const ObjectModel model = Model(Box({0, 0, 0}, {0.2, 0.2, 0.1}) + Box({0, 0, 0.0525}, {0.1, 0.1, 0.005}, 8));
  const VisibilityTester tester(model, {});
  const auto sides = [&](const Eigen::Vector3d& eye, double x_m, double z_m) {
    const Eigen::Vector3d p1(x_m, -0.04, z_m), p2(x_m, 0.04, z_m);
    return SidesOf({eye, p1, p2, 1000.0}, tester.faces(), model.diameter_m);
  };
  const Eigen::Vector3d front(0, 0, 1), side(0.6, 0, 0.6);
  EXPECT_EQ(sides(front, 0.05, 0.055), EdgeSides::kParallel);  // the step
  EXPECT_EQ(sides(side, 0.05, 0.055), EdgeSides::kDifferent);  // its wall, 4 px wide, is between the faces
  EXPECT_EQ(sides(side, -0.05, 0.055), EdgeSides::kParallel);  // the hidden wall
  EXPECT_EQ(sides(front, 0.1, 0.05), EdgeSides::kBackground);  // the background is beside the plate
  EXPECT_EQ(sides(side, 0.1, 0.05), EdgeSides::kDifferent);    // the plate's side
}

TEST(VisibilityTest, LineIsSplitByABarInFrontOfIt) {
  const ObjectModel model = Model(CentredCube() + Box({0, 0, 0.175}, {0.03, 0.6, 0.02}, 8));
  const auto parts = Of(See(model, ViewFrom({0, 0, 1})), model, {0, 0.075, 0.075});
  ASSERT_THAT(parts, SizeIs(2));
  // The bar's front, at z = 0.185, hides |x| < 0.015 (1 - 0.075) / (1 - 0.185) on the line.
  const double half_hidden = 0.015 * 0.925 / 0.815 / 0.15;
  EXPECT_NEAR(parts[0].begin, 0.0, 1e-12);
  EXPECT_NEAR(parts[0].end, 0.5 - half_hidden, 3e-4);
  EXPECT_NEAR(parts[1].begin, 0.5 + half_hidden, 3e-4);
  EXPECT_NEAR(parts[1].end, 1.0, 1e-12);
}

TEST(VisibilityTest, LinesAreCutAtTheImage) {
  const ObjectModel cube = Model(CentredCube());
  RigidTransform pose = ViewFrom({0, 0, 0.8});
  pose.translation_m.x() +=
      640.0 / 1000.0 * 0.725;  // the face's middle now lies on the right border, but for half a pixel
  const CameraModel camera = Camera();
  const auto segments = See(cube, pose);
  ASSERT_FALSE(segments.empty());
  int cut = 0;
  for (const VisibleSegment& segment : segments) {
    const ModelLine& line = cube.lines[segment.line];
    for (const double s : {segment.begin, segment.end}) {
      const Eigen::Vector2d pixel = camera.Project(pose * Eigen::Vector3d(line.p1 + s * (line.p2 - line.p1)));
      EXPECT_LE(pixel.x(), 1279.5 + 1e-6);
      cut += std::abs(pixel.x() - 1279.5) < 1e-6;
    }
  }
  EXPECT_EQ(cut, 2);
  pose.translation_m.x() += 0.5;
  EXPECT_THAT(See(cube, pose), IsEmpty());
}

TEST(VisibilityTest, LineThatCrossesTheImageWithBothEndsOutside) {
  const ObjectModel model = Model("v -5 0 0\nv 5 0 0\nl 1 2\n");
  const auto segments = See(model, {Eigen::Matrix3d::Identity(), {0, 0, 1}});
  ASSERT_THAT(segments, SizeIs(1));
  EXPECT_NEAR(segments[0].begin, 0.5 - 0.06405, 1e-9);
  EXPECT_NEAR(segments[0].end, 0.5 + 0.06395, 1e-9);
}

TEST(VisibilityTest, LineThatPassesTheCamera) {
  const ObjectModel model = Model("v 0.1 0 -3\nv 0.1 0 3\nl 1 2\n");
  const auto segments = See(model, {});
  ASSERT_THAT(segments, SizeIs(1));
  // The segment is in the image from x = 639.5 / 1000 z = 0.1 on.
  EXPECT_NEAR(-3 + 6 * segments[0].begin, 0.1 / 0.6395, 1e-7);
  EXPECT_EQ(segments[0].end, 1.0);
  EXPECT_THAT(See(model, {Eigen::Matrix3d::Identity(), {0, 0, -4}}), IsEmpty());
}

std::string PlanarTarget() {
  return "v -0.2 -0.15 0\nv 0.2 -0.15 0\nv 0.2 0.15 0\nv -0.2 0.15 0\nf 1 2 3 4\n"
         "v -0.1 -0.1 0\nv 0.1 -0.1 0\nv 0.1 0.1 0\nv -0.1 0.1 0\nl 5 6\nl 6 7\nl 7 8\nl 8 5\nl 5 7\nl 6 8\n";
}

TEST(VisibilityTest, PlanarTargetFromTheFrontAndFromBehind) {
  const ObjectModel target = Model(PlanarTarget());
  EXPECT_THAT(See(target, ViewFrom({0.2, 0.1, 1})), SizeIs(6));
  EXPECT_THAT(See(target, ViewFrom({0, 0, 1})), SizeIs(6));
  EXPECT_THAT(See(target, ViewFrom({0.2, 0.1, -1})), IsEmpty());
}

TEST(VisibilityTest, SheetShowsItsBoundaryFromTheFront) {
  const ObjectModel sheet = Model("v 0 0 0\nv 0.2 0 0\nv 0.2 0.2 0\nv 0 0.2 0\nf 1 2 3 4\n");
  EXPECT_THAT(See(sheet, ViewFrom({0.1, 0.3, 1})), SizeIs(4));
  EXPECT_THAT(See(sheet, ViewFrom({0.1, 0.3, -1})), IsEmpty());
}

TEST(VisibilityTest, WireframeHidesNothing) {
  const ObjectModel wire = Model(
      "v 0 0 0\nv .1 0 0\nv .1 .1 0\nv 0 .1 0\nv 0 0 .1\nv .1 0 .1\nv .1 .1 .1\nv 0 .1 .1\n"
      "l 1 2 3 4 1\nl 5 6 7 8 5\nl 1 5\nl 2 6\nl 3 7\nl 4 8\n");
  EXPECT_THAT(See(wire, ViewFrom({0.5, 0.3, 0.8})), SizeIs(12));
}

TEST(VisibilityTest, WireBehindAFaceIsHidden) {
  const ObjectModel model = Model(CentredCube() + "v -0.3 0 -0.2\nv 0.3 0 -0.2\nl 9 10\n");
  const auto segments = See(model, ViewFrom({0, 0, 1}));
  ASSERT_THAT(segments, SizeIs(2));
  // The front face's border, 0.075 at depth 0.925, hides 0.0973 at depth 1.2.
  EXPECT_NEAR(segments[0].end, 0.5 - 0.075 / 0.925 * 1.2 / 0.6, 1e-3);
  EXPECT_NEAR(segments[1].begin, 0.5 + 0.075 / 0.925 * 1.2 / 0.6, 1e-3);
}

TEST(VisibilityTest, CameraInsideSeesNothingOfTheOutside) {
  EXPECT_THAT(See(Model(Box({0, 0, 0}, {2, 2, 2})), ViewFrom({0, 0, 0.1})), IsEmpty());
}

TEST(VisibilityTest, GrazingFacesKeepTheirLines) {
  const ObjectModel cube = Model(CentredCube());
  const auto seen_far_edge = [&](double height_m) {
    // The top's far edge, with the camera this much above the plane of the top.
    return !Of(See(cube, ViewFrom({0.8, 0.001, 0.075 + height_m})), cube, {-0.075, 0, 0.075}).empty();
  };
  EXPECT_TRUE(seen_far_edge(0.3));
  EXPECT_TRUE(seen_far_edge(0.005));
  EXPECT_TRUE(seen_far_edge(0.0));
  EXPECT_TRUE(seen_far_edge(-0.010));  // cosine -0.011
  EXPECT_FALSE(seen_far_edge(-0.05));
  VisibilityOptions strict;
  strict.grazing_cosine = 0.0;
  EXPECT_TRUE(Of(See(cube, ViewFrom({0.8, 0.001, 0.070}), strict), cube, {-0.075, 0, 0.075}).empty());
}

TEST(VisibilityTest, LinesDrawnOnAGrazingFaceOfASolidAreLeftOut) {
  VisibilityOptions options;
  options.painted_cosine = 0.15;
  const auto sees = [&](const ObjectModel& model, double height_m, const Eigen::Vector3d& middle) {
    return !Of(See(model, ViewFrom({0.8, 0.001, 0.075 + height_m}), options), model, middle).empty();
  };
  // The model has the edges of a cube and a drawn line across its top.
  const ObjectModel cube = Model(CentredCube() + "v 0 -0.075 0.075\nv 0 0.075 0.075\nl 9 10\nl 5 6 7 8 5\n");
  EXPECT_TRUE(sees(cube, 0.2, {0, 0, 0.075}));
  EXPECT_FALSE(sees(cube, 0.08, {0, 0, 0.075})) << "cosine 0.1";
  EXPECT_TRUE(sees(cube, 0.08, {-0.075, 0, 0.075})) << "the edge of the face";
  // On a sheet nothing else would be left.
  const ObjectModel sheet = Model(
      "v -.1 -.1 .075\nv .1 -.1 .075\nv .1 .1 .075\nv -.1 .1 .075\nf 1 2 3 4\n"
      "v 0 -.075 .075\nv 0 .075 .075\nl 5 6\n");
  EXPECT_TRUE(sees(sheet, 0.08, {0, 0, 0.075}));
}

TEST(VisibilityTest, ShortPiecesAreLeftOut) {
  const ObjectModel sheet = Model("v 0 0 0\nv 0.2 0 0\nv 0.2 0.2 0\nv 0 0.2 0\nf 1 2 3 4\n");
  EXPECT_THAT(See(sheet, ViewFrom({0, 0, 60})), IsEmpty());  // 3.3 px
  VisibilityOptions options;
  options.min_length_px = 3.0;
  EXPECT_THAT(See(sheet, ViewFrom({0, 0, 60}), options), SizeIs(4));
}

TEST(VisibilityTest, DistortionMovesTheBorderOfTheView) {
  CameraModel camera = Camera();
  camera.distortion = {-0.2, 0.0, 0.0, 0.0, 0.0};
  const ObjectModel model = Model("v -5 0 0\nv 5 0 0\nl 1 2\n");
  const auto segments = See(model, {Eigen::Matrix3d::Identity(), {0, 0, 1}}, {}, camera);
  ASSERT_THAT(segments, SizeIs(1));
  for (const double s : {segments[0].begin, segments[0].end}) {
    const Eigen::Vector2d pixel = camera.Distort(camera.Project({-5 + 10 * s, 0, 1}));
    EXPECT_NEAR(std::abs(pixel.x() - 639.5), 640.0, 1.0);
  }
  // Barrel distortion sees farther than the pinhole's 0.06405.
  EXPECT_LT(segments[0].begin, 0.5 - 0.068);
}

TEST(VisibilityTest, PointVisibility) {
  const ObjectModel cube = Model(CentredCube());
  const VisibilityTester tester(cube, {});
  const Eigen::Vector3d eye(0, 0, 1);
  EXPECT_TRUE(tester.IsPointVisible(eye, {0, 0, 0.075}));   // on the face
  EXPECT_TRUE(tester.IsPointVisible(eye, {0, 0, 0.0749}));  // within the tolerance of 0.26 mm behind it
  EXPECT_FALSE(tester.IsPointVisible(eye, {0, 0, 0.07}));
  EXPECT_FALSE(tester.IsPointVisible(eye, {0, 0, -1}));
  EXPECT_TRUE(tester.IsPointVisible(eye, {0, 0, 0.5}));
  EXPECT_TRUE(tester.IsPointVisible(eye, {0.2, 0, -1}));
}

// A bumpy landscape of 2 n^2 triangles.
ObjectModel Landscape(int n) {
  std::mt19937 random(6);
  std::string obj;
  for (int i = 0; i <= n; ++i) {
    for (int j = 0; j <= n; ++j) {
      absl::StrAppendFormat(&obj, "v %g %g %g\n", 1.0 * i / n, 1.0 * j / n, 0.2 * (random() % 1000) / 1000);
    }
  }
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      const int a = i * (n + 1) + j + 1;
      absl::StrAppendFormat(&obj, "f %d %d %d\nf %d %d %d\n", a, a + 1, a + n + 2, a, a + n + 2, a + n + 1);
    }
  }
  return Model(obj + "l 1 2\n");
}

TEST(VisibilityTest, HierarchyEqualsTestingEveryTriangle) {
  const ObjectModel model = Landscape(20);
  const VisibilityTester tester(model, {});
  const double tolerance_m = 1e-3 * model.diameter_m;
  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(-0.2, 1.2);
  int hidden = 0;
  for (int trial = 0; trial < 3000; ++trial) {
    const Eigen::Vector3d origin(uniform(random), uniform(random), uniform(random));
    const Eigen::Vector3d point(uniform(random), uniform(random), uniform(random));
    bool expected = false;
    for (const auto& [i, j, k] : model.triangles) {
      // Same side of three planes through the origin's ray, by signed volumes.
      const Eigen::Vector3d &a = model.vertices[i], &b = model.vertices[j], &c = model.vertices[k];
      const auto volume = [](const Eigen::Vector3d& p, const Eigen::Vector3d& q, const Eigen::Vector3d& r,
                             const Eigen::Vector3d& s) { return (q - p).cross(r - p).dot(s - p); };
      const double v1 = volume(origin, a, b, point), v2 = volume(origin, b, c, point), v3 = volume(origin, c, a, point);
      const bool through = (v1 > 0 && v2 > 0 && v3 > 0) || (v1 < 0 && v2 < 0 && v3 < 0);
      const double height = volume(a, b, c, point) / (b - a).cross(c - a).norm();
      expected |= through && (height > 0) != (volume(a, b, c, origin) > 0) && std::abs(height) > tolerance_m;
    }
    EXPECT_EQ(tester.IsPointVisible(origin, point), !expected);
    hidden += expected;
  }
  EXPECT_GT(hidden, 500);
  EXPECT_LT(hidden, 2500);
}

TEST(VisibilityTest, RaysAlongTheAxesAndThroughTheCornersOfBoxes) {
  const ObjectModel model = Model(Box({0, 0, 0}, {2, 2, 2}) + Box({4, 0, 0}, {2, 2, 2}, 8));
  const VisibilityTester tester(model, {});
  EXPECT_FALSE(tester.IsPointVisible({0.5, 0.25, 9}, {0.5, 0.25, -9}));
  EXPECT_TRUE(tester.IsPointVisible({2, 0.25, 9}, {2, 0.25, -9}));  // between them
  EXPECT_FALSE(tester.IsPointVisible({0, 0, 9}, {0, 0, -9}));       // through the diagonal of two triangles
  EXPECT_TRUE(tester.IsPointVisible({0, 0, 9}, {0, 0, 9}));
}

TEST(VisibilityTest, OptionsNameTheWrongField) {
  const auto message = [](auto&& change) {
    VisibilityOptions options;
    change(options);
    return std::string(options.Validate().message());
  };
  EXPECT_TRUE(VisibilityOptions().Validate().ok());
  EXPECT_THAT(message([](auto& o) { o.samples_per_line = 1; }), HasSubstr("samples_per_line"));
  EXPECT_THAT(message([](auto& o) { o.surface_tolerance = 0; }), HasSubstr("surface_tolerance"));
  EXPECT_THAT(message([](auto& o) { o.surface_tolerance = std::nan(""); }), HasSubstr("surface_tolerance"));
  EXPECT_THAT(message([](auto& o) { o.min_length_px = -1; }), HasSubstr("min_length_px"));
  EXPECT_THAT(message([](auto& o) { o.grazing_cosine = 2; }), HasSubstr("grazing_cosine"));
  EXPECT_THAT(message([](auto& o) { o.painted_cosine = -2; }), HasSubstr("painted_cosine"));
}

}  // namespace
}  // namespace evpose
