// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/line_near_symmetries.h"

#include <gtest/gtest.h>

#include <numbers>

#include "core/initialization/direction_symmetries.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kRadiusM = 0.2;

void AddBox(const Vector3d& centre, const Vector3d& size, std::vector<ModelLine>& lines) {
  for (int corner = 0; corner < 8; ++corner) {
    const auto point = [&](int c) {
      const Vector3d side((c & 1) - 0.5, (c >> 1 & 1) - 0.5, (c >> 2 & 1) - 0.5);
      return Vector3d(centre + side.cwiseProduct(size));
    };
    for (int axis = 0; axis < 3; ++axis) {
      if ((corner >> axis & 1) == 0) lines.push_back({point(corner), point(corner | 1 << axis), {}});
    }
  }
}

// A box that is no cube and not centred at the origin, with a smaller box (the mast) on one of its sides.
std::vector<ModelLine> BoxWithMast(double mast_ratio) {
  std::vector<ModelLine> lines;
  const Vector3d centre(0.5, -0.3, 0.1), size(0.3, 0.2, 0.12);
  AddBox(centre, size, lines);
  AddBox(centre + Vector3d(0.07, 0.12, 0.03), mast_ratio * size, lines);
  return lines;
}

std::vector<Matrix3d> Rotations() {
  return DirectionSymmetries(std::vector<Vector3d>{Vector3d::UnitX(), Vector3d::UnitY(), Vector3d::UnitZ()});
}

TEST(FindLineNearSymmetries, AreTheHalfTurnsOfABoxWithAMast) {
  const std::vector<RigidTransform> near_symmetries = FindLineNearSymmetries(BoxWithMast(0.2), Rotations(), kRadiusM);
  ASSERT_EQ(near_symmetries.size(), 3u);
  const Vector3d centre(0.5, -0.3, 0.1);
  for (const RigidTransform& near_symmetry : near_symmetries) {
    EXPECT_NEAR(RotationAngle(near_symmetry.rotation, Matrix3d::Identity()), std::numbers::pi, 1e-9);
    EXPECT_LT((near_symmetry * centre - centre).norm(), 1e-9) << "it turns about the box's centre";
  }
}

TEST(FindLineNearSymmetries, LessThanHalfOfTheLinesIsNotEnough) {
  std::vector<ModelLine> lines = BoxWithMast(0.2);
  // A comb beside the box, without any symmetry, with a larger total length than the box's lines.
  double z_m = 0.0;
  for (int i = 1; i <= 12; ++i) {
    z_m += 0.02 + 0.001 * i * i;
    lines.push_back({{0.8, -0.3, z_m}, {0.8 + 0.2 + 0.013 * i, -0.3, z_m}, {}});
  }
  EXPECT_TRUE(FindLineNearSymmetries(lines, Rotations(), 2.0 * kRadiusM).empty());
}

TEST(FindLineNearSymmetries, AnEdgeInTwoPartsIsTheEdge) {
  std::vector<ModelLine> lines = BoxWithMast(0.2);
  for (size_t i = 0; i < 6; ++i) {
    const Vector3d middle = 0.3 * lines[i].p1 + 0.7 * lines[i].p2;
    lines.push_back({middle, lines[i].p2, {}});
    lines[i].p2 = middle;
  }
  EXPECT_EQ(FindLineNearSymmetries(lines, Rotations(), kRadiusM).size(), 3u);
}

TEST(FindLineNearSymmetries, TheIdentityIsNone) {
  EXPECT_TRUE(FindLineNearSymmetries(BoxWithMast(0.2), std::vector<Matrix3d>{Matrix3d::Identity()}, kRadiusM).empty());
  EXPECT_TRUE(FindLineNearSymmetries({}, std::vector<Matrix3d>{Rotations().back()}, kRadiusM).empty());
}

}  // namespace
}  // namespace evpose
