// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/free_motion.h"

#include <Eigen/Geometry>

#include "core/models/continuous_symmetry.h"

namespace evpose {
namespace {

// Standard deviations of the prior along the free directions: far below those of other directions in a window (1e-3 rad
// and 0.1 rad/s), and large enough that the inverse of the covariance is accurate to nine digits.
constexpr double kFixedAngleRad = 1e-4;
constexpr double kFixedSpinRadPerS = 1e-3;

// core/estimation/README.md, equation (13).
Matrix6d WithoutSpin(const FreeDirections& directions) {
  Matrix6d projection = Matrix6d::Identity();
  projection.rightCols<3>() -= directions * directions.bottomRows<3>().transpose();
  return projection;
}

Matrix6d Symmetric(const Matrix6d& matrix) { return 0.5 * (matrix + matrix.transpose()); }

}  // namespace

void RemoveFreeMotion(const std::optional<ContinuousSymmetry>& symmetry, MotionState& state) {
  if (!symmetry) return;
  const FreeDirections directions = FreeDirectionsAt(*symmetry, state.camera_from_object);
  const Matrix6d projection = WithoutSpin(directions);
  state.twist = projection * state.twist;
  const Matrix6d free = directions * directions.transpose();
  const Matrix6d pose = projection * state.covariance.topLeftCorner<6, 6>() * projection.transpose();
  const Matrix6d twist = projection * state.covariance.bottomRightCorner<6, 6>() * projection.transpose();
  const Matrix6d both = projection * state.covariance.topRightCorner<6, 6>() * projection.transpose();
  state.covariance.topLeftCorner<6, 6>() = Symmetric(pose) + kFixedAngleRad * kFixedAngleRad * free;
  state.covariance.bottomRightCorner<6, 6>() = Symmetric(twist) + kFixedSpinRadPerS * kFixedSpinRadPerS * free;
  state.covariance.topRightCorner<6, 6>() = both;
  state.covariance.bottomLeftCorner<6, 6>() = both.transpose();
}

void RemoveFreeMotion(const std::optional<ContinuousSymmetry>& symmetry, const MotionState& before,
                      MotionState& state) {
  if (!symmetry) return;
  const Eigen::Vector3d origin_m = state.camera_from_object.translation_m;
  state.camera_from_object = NearestWithoutFlip(state.camera_from_object, *symmetry, before.camera_from_object);
  // The twist is that of the origin of the object, which the spin has moved.
  const Eigen::Vector3d moved_m = state.camera_from_object.translation_m - origin_m;
  state.twist.head<3>() += state.twist.tail<3>().cross(moved_m);
  RemoveFreeMotion(symmetry, state);
}

Matrix6d WithFreeAngle(const std::optional<ContinuousSymmetry>& symmetry, const RigidTransform& camera_from_object,
                       const Matrix6d& covariance) {
  if (!symmetry) return covariance;
  const FreeDirections directions = FreeDirectionsAt(*symmetry, camera_from_object);
  const Matrix6d projection = WithoutSpin(directions);
  return Symmetric(projection * covariance * projection.transpose()) +
         kFreeAngleVarianceRad2 * directions * directions.transpose();
}

}  // namespace evpose
