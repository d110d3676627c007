// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/near_symmetries.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/models/cube_files_testing.h"

namespace evpose {
namespace {

using Eigen::Vector3d;

constexpr double kHalfTurnRad = std::numbers::pi;

// A cuboid from the origin with its twelve edges as line elements, and one more line, the mark.
std::string MarkedCuboid(const Vector3d& size, const Vector3d& mark_begin, const Vector3d& mark_end) {
  std::string obj;
  for (int i = 0; i < 8; ++i) {
    absl::StrAppend(&obj, "v ", i & 1 ? size.x() : 0.0, " ", i & 2 ? size.y() : 0.0, " ", i & 4 ? size.z() : 0.0, "\n");
  }
  for (const Vector3d& end : {mark_begin, mark_end}) {
    absl::StrAppend(&obj, "v ", end.x(), " ", end.y(), " ", end.z(), "\n");
  }
  absl::StrAppend(&obj, "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n");
  for (int i = 0; i < 8; ++i) {
    for (const int bit : {1, 2, 4}) {
      if ((i & bit) == 0) absl::StrAppend(&obj, "l ", i + 1, " ", i + bit + 1, "\n");
    }
  }
  return absl::StrCat(obj, "l 9 10\n");
}

std::vector<NearSymmetry> NearOf(const ObjectModel& model, double contour_share = 0.0) {
  return FindNearSymmetries(model, contour_share).value();
}

TEST(NearSymmetries, ACuboidWithAMarkIsNearlyItsThreeHalfTurns) {
  const ObjectModel model = MustParse(MarkedCuboid({0.3, 0.2, 0.1}, {0.05, 0.04, 0.1}, {0.11, 0.04, 0.1}));
  EXPECT_EQ(model.symmetries.size(), 1u);
  const std::vector<NearSymmetry> near = NearOf(model);
  ASSERT_EQ(near.size(), 3u);
  std::array<int, 3> about = {};
  for (const NearSymmetry& symmetry : near) {
    EXPECT_NEAR(symmetry.angle_rad, kHalfTurnRad, 0.01);
    EXPECT_FALSE(symmetry.is_any_angle);
    Eigen::Index axis = 0;
    EXPECT_GT(symmetry.axis.maxCoeff(&axis), 0.9999);
    ++about[axis];
    // The mark has 0.06 m of 2.46 m.
    EXPECT_NEAR(symmetry.differing_edges, 0.06 / 2.46, 0.002);
    EXPECT_EQ(symmetry.differing_share, symmetry.differing_edges);
    EXPECT_LT(symmetry.displacement_ratio, 1e-3);
    // The turned cuboid is where it was.
    EXPECT_LT((symmetry.object_from_object * Vector3d(0.15, 0.1, 0.05) - Vector3d(0.15, 0.1, 0.05)).norm(), 2e-3);
  }
  EXPECT_THAT(about, testing::Each(1));
}

TEST(NearSymmetries, OfThoseThatDifferByASymmetryOnlyOneIsGiven) {
  // The mark goes through the axis: half a turn about z is a symmetry, and those about x and y differ by it.
  const ObjectModel model = MustParse(MarkedCuboid({0.3, 0.2, 0.1}, {0.1, 0.1, 0.1}, {0.2, 0.1, 0.1}));
  EXPECT_EQ(model.symmetries.size(), 2u);
  const std::vector<NearSymmetry> near = NearOf(model);
  ASSERT_EQ(near.size(), 1u);
  EXPECT_NEAR(near[0].angle_rad, kHalfTurnRad, 0.01);
  EXPECT_LT(std::abs(near[0].axis.z()), 0.01);
}

TEST(NearSymmetries, ACubeHasExactOnesOnly) {
  EXPECT_EQ(MustParse(Cube()).symmetries.size(), 24u);
  EXPECT_TRUE(NearOf(MustParse(Cube())).empty());
}

TEST(NearSymmetries, AMarkMakesThoseOfACubeNearOnes) {
  const std::vector<NearSymmetry> near = NearOf(MustParse(MarkedCuboid({1, 1, 1}, {0.2, 0.3, 1.0}, {0.5, 0.3, 1.0})));
  // Apart from the inverse rotations there are those about three axes of faces by 90 and by 180 degrees, six of edges,
  // four of corners.
  EXPECT_EQ(near.size(), 16u);
  for (const NearSymmetry& symmetry : near) EXPECT_NEAR(symmetry.differing_edges, 0.3 / 12.3, 0.003);
  EXPECT_EQ(std::count_if(near.begin(), near.end(), [](const auto& n) { return n.angle_rad > 3.1; }), 9);
}

TEST(NearSymmetries, AnLProfileHasNone) {
  const std::string profile =
      "v 0 0 0\nv 60 0 0\nv 60 8 0\nv 8 8 0\nv 8 40 0\nv 0 40 0\n"
      "v 0 0 65\nv 60 0 65\nv 60 8 65\nv 8 8 65\nv 8 40 65\nv 0 40 65\n"
      "f 4 3 2 1\nf 6 5 4 1\nf 7 8 9 10\nf 7 10 11 12\n"
      "f 1 2 8 7\nf 2 3 9 8\nf 3 4 10 9\nf 4 5 11 10\nf 5 6 12 11\nf 6 1 7 12\n";
  const ObjectModel model = MustParse(profile);
  EXPECT_EQ(model.symmetries.size(), 1u);
  EXPECT_EQ(model.lines.size(), 18u);
  EXPECT_TRUE(NearOf(model).empty());
}

// Turned by a few degrees about its long axis, no part of a bar moves by more than the tolerance.
TEST(NearSymmetries, ASmallRotationOfAThinBarIsNone) {
  for (const NearSymmetry& near :
       NearOf(MustParse(MarkedCuboid({1, 0.05, 0.04}, {0.1, 0.01, 0.04}, {0.3, 0.02, 0.04})))) {
    EXPECT_GT(near.angle_rad, 0.5);
  }
}

// A cylinder with a line along its side, of height 1, beside rims of 4 pi.
TEST(NearSymmetries, ACylinderWithAMarkIsNearlyAllRotationsAboutItsAxis) {
  constexpr int kSides = 72;
  std::string obj = Prism(kSides);
  for (const int first : {1, 2}) {
    absl::StrAppend(&obj, "l");
    for (int i = 0; i <= kSides; ++i) absl::StrAppend(&obj, " ", 2 * (i % kSides) + first);
    absl::StrAppend(&obj, "\n");
  }
  const ObjectModel plain = MustParse(obj);
  ASSERT_TRUE(plain.continuous_symmetry.has_value());
  EXPECT_TRUE(NearOf(plain, 0.3).empty());
  const ObjectModel marked = MustParse(obj + "l 1 2\n");
  EXPECT_FALSE(marked.continuous_symmetry.has_value());
  const std::vector<NearSymmetry> near = NearOf(marked, 0.3);
  // Two half turns leave the ends of the mark where they were.
  const auto any = std::find_if(near.begin(), near.end(), [](const auto& n) { return n.is_any_angle; });
  ASSERT_NE(any, near.end());
  EXPECT_GT(any->axis.z(), 0.999);
  EXPECT_NEAR(any->differing_edges, 1.0 / (1.0 + 4.0 * std::numbers::pi), 0.005);
  EXPECT_LT(any->differing_contours, 0.005) << "the samples are as dense";
  EXPECT_NEAR(any->differing_share, 0.7 * any->differing_edges + 0.3 * any->differing_contours, 1e-12);
  for (const NearSymmetry& other : near) {
    if (other.is_any_angle) continue;
    EXPECT_LT(std::abs(other.axis.z()), 0.1) << "the others turn the axis over";
  }
}

// A prism of twelve sides with a mark looks the same after every twelfth of a turn, and not between them.
TEST(NearSymmetries, APrismWithAMarkIsNotNearlyRound) {
  constexpr int kSides = 12;
  std::string obj = Prism(kSides) + "v 0.3 0.2 1\nv 0.6 0.3 1\n";
  for (int i = 0; i < kSides; ++i) {
    const int a = 2 * i + 1, b = 2 * ((i + 1) % kSides) + 1;
    absl::StrAppend(&obj, "l ", a, " ", b, "\nl ", a + 1, " ", b + 1, "\nl ", a, " ", a + 1, "\n");
  }
  const ObjectModel plain = MustParse(obj, ModelFormat::kObj, AsIs());
  EXPECT_EQ(plain.symmetries.size(), 24u);
  EXPECT_TRUE(NearOf(plain).empty());
  const std::vector<NearSymmetry> near = NearOf(MustParse(obj + "l 25 26\n", ModelFormat::kObj, AsIs()));
  EXPECT_FALSE(near.empty());
  for (const NearSymmetry& symmetry : near) {
    EXPECT_FALSE(symmetry.is_any_angle);
    const double twelfths = symmetry.angle_rad / (kHalfTurnRad / 6.0);
    EXPECT_NEAR(twelfths, std::round(twelfths), 0.02);
  }
}

TEST(NearSymmetries, InvalidOptionsAreNamed) {
  const ObjectModel cube = MustParse(Cube());
  EXPECT_THAT(FindNearSymmetries(cube, 1.5).status().message(), testing::HasSubstr("contour_share"));
  EXPECT_THAT(FindNearSymmetries(cube, 0.0, {.tolerance_ratio = 0.0}).status().message(),
              testing::HasSubstr("tolerance_ratio"));
  EXPECT_THAT(FindNearSymmetries(cube, 0.0, {.max_differing_share = 0.9}).status().message(),
              testing::HasSubstr("max_differing_share"));
}

}  // namespace
}  // namespace evpose
