// SPDX-License-Identifier: Apache-2.0
#include "server/models/prepared_model.h"

#include "core/models/cube_files_testing.h"
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
