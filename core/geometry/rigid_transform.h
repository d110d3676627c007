// SPDX-License-Identifier: Apache-2.0

// Rigid transforms and their tangent space.
//
// target_from_source: x_target = rotation * x_source + translation. The tangent is
// xi = [translation (m), rotation (rad)], applied on the left as in core/geometry/README.md, section 3:
// R <- exp(dtheta^) R, T <- T + dt. Covariances and twists use the same order and side.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "absl/status/statusor.h"
#include "core/base/state_io.h"

namespace evpose {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

struct RigidTransform {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation_m = Eigen::Vector3d::Zero();

  Eigen::Vector3d operator*(const Eigen::Vector3d& point) const { return rotation * point + translation_m; }
  RigidTransform operator*(const RigidTransform& other) const {
    return {rotation * other.rotation, rotation * other.translation_m + translation_m};
  }
  RigidTransform Inverse() const { return {rotation.transpose(), -(rotation.transpose() * translation_m)}; }
  // Unit quaternion with w >= 0.
  Eigen::Quaterniond Quaternion() const;

  static void VisitState(auto& archive, auto& self) {
    auto& [rotation, translation_m] = self;
    archive(Finite(rotation), Finite(translation_m));
    // What is far from one grows when it is made one again, until its numbers overflow.
    archive.Check(rotation.isUnitary(1e-3), "a matrix that is no rotation");
  }
};

// Errors: INVALID_ARGUMENT when the norm differs from 1 by more than 1e-3 or a number is not finite.
absl::StatusOr<RigidTransform> MakeRigidTransform(const Eigen::Vector3d& translation_m,
                                                  const Eigen::Quaterniond& quaternion);

Eigen::Matrix3d Hat(const Eigen::Vector3d& v);                // Hat(v) w = v x w
Eigen::Matrix3d ExpSo3(const Eigen::Vector3d& rotation_rad);  // Rodrigues
Eigen::Vector3d LogSo3(const Eigen::Matrix3d& rotation);      // angle in [0, pi]
Eigen::Matrix3d LeftJacobianSo3(const Eigen::Vector3d& rotation_rad);
Eigen::Matrix3d LeftJacobianInverseSo3(const Eigen::Vector3d& rotation_rad);

// SE(3), tangent ordered [translation, rotation]; the translation part of Exp is J v (core/geometry/README.md, section
// 1).
RigidTransform ExpSe3(const Vector6d& tangent);
Vector6d LogSe3(const RigidTransform& transform);

// R <- exp(dtheta^) R, T <- T + dt with xi = [dt, dtheta]; re-orthonormalises the rotation.
RigidTransform Perturb(const RigidTransform& transform, const Vector6d& xi);
// The xi with Perturb(from, xi) = to.
Vector6d Difference(const RigidTransform& to, const RigidTransform& from);

// Angle of a^-1 b in radians, [0, pi].
double RotationAngle(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b);

}  // namespace evpose
