// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/surface_distance.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "core/contours/contour_shapes_testing.h"

namespace evpose {
namespace {

RigidTransform PoseOf(const Eigen::Vector3d& translation_m, const Eigen::Vector3d& axis, double angle_rad) {
  RigidTransform pose;
  pose.rotation = Eigen::AngleAxisd(angle_rad, axis.normalized()).toRotationMatrix();
  pose.translation_m = translation_m;
  return pose;
}

const RigidTransform kTruth = PoseOf({0.1, -0.05, 0.8}, {0.3, 1.0, -0.2}, 0.9);

TEST(SurfaceDistanceTest, PosesThatLookTheSameHaveNone) {
  const SurfaceDistance distance(CylinderModel(0.08, 0.05, 240));
  EXPECT_NEAR(distance.Between(kTruth, kTruth), 0.0, 1e-12);
  // Any angle about the axis; the facets of 1.5 degrees are within 5e-6 m of the cylinder.
  for (const double angle : {0.1, 1.0, 2.5}) {
    EXPECT_LT(distance.Between(kTruth, kTruth * PoseOf({0, 0, 0}, {0, 0, 1}, angle)), 5e-6);
  }
  EXPECT_LT(distance.Between(kTruth, kTruth * PoseOf({0, 0, 0}, {1, 0, 0}, M_PI)), 5e-6) << "turned over";
  EXPECT_GT(distance.Between(kTruth, kTruth * PoseOf({0, 0, 0}, {1, 0, 0}, 0.1)), 2e-3);
}

TEST(SurfaceDistanceTest, AShiftMovesTheSurfaceByItsPartAlongTheNormal) {
  const double radius_m = 0.1, shift_m = 0.004;
  const SurfaceDistance distance(SphereModel(radius_m, 160, false));
  RigidTransform moved = kTruth;
  moved.translation_m.y() += shift_m;
  // The mean of |cos| over a sphere is a half.
  EXPECT_NEAR(distance.Between(kTruth, moved), 0.5 * shift_m, 0.03 * shift_m);
  moved.translation_m.y() += 10.0;
  EXPECT_NEAR(distance.Between(kTruth, moved), 10.0 + shift_m - radius_m, 0.02);
}

}  // namespace
}  // namespace evpose
