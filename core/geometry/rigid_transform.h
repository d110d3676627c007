// SPDX-License-Identifier: Apache-2.0

// Rigid transforms and their tangent space.
//
// target_from_source: x_target = rotation * x_source + translation. The tangent is
// xi = [translation (m), rotation (rad)], applied on the left as in core/geometry/README.md, section 1:
// R <- exp([dtheta]x) R, T <- T + dt. Covariances and twists use the same order and side.
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

  bool operator==(const RigidTransform&) const = default;

  static void VisitState(auto& archive, auto& self) {
    auto& [rotation, translation_m] = self;
    archive(Finite(rotation), Finite(translation_m));
    // Orthonormalisation diverges for a matrix far from a rotation.
    archive.Check(rotation.isUnitary(1e-3), "a matrix is not a rotation");
  }
};

// The motion that rotates about a point, in the frame of the point.
inline RigidTransform RotationAbout(const Eigen::Vector3d& point, const Eigen::Matrix3d& rotation) {
  return {rotation, point - rotation * point};
}

// Normalises the quaternion. Errors: INVALID_ARGUMENT if its norm differs from 1 by more than 1e-3, which hints at
// wrong numbers rather than rounding, or if a number is not finite.
absl::StatusOr<RigidTransform> MakeRigidTransform(const Eigen::Vector3d& translation_m,
                                                  const Eigen::Quaterniond& quaternion);

Eigen::Matrix3d Hat(const Eigen::Vector3d& v);                // Hat(v) w = v x w
Eigen::Matrix3d ExpSo3(const Eigen::Vector3d& rotation_rad);  // Rodrigues' formula
Eigen::Vector3d LogSo3(const Eigen::Matrix3d& rotation);      // angle in [0, pi]
Eigen::Matrix3d LeftJacobianSo3(const Eigen::Vector3d& rotation_rad);
Eigen::Matrix3d LeftJacobianInverseSo3(const Eigen::Vector3d& rotation_rad);

// The exponential map of SE(3) and its inverse, with the tangent [translation v, rotation r]: the translation of Exp is
// J(r) v, J the left Jacobian of SO(3). For interpolation; estimation uses Perturb().
RigidTransform ExpSe3(const Vector6d& tangent);
Vector6d LogSe3(const RigidTransform& transform);

// R <- exp([dtheta]x) R, T <- T + dt with xi = [dt, dtheta]; re-orthonormalises the rotation.
RigidTransform Perturb(const RigidTransform& transform, const Vector6d& xi);
// The xi with Perturb(from, xi) = to.
Vector6d Difference(const RigidTransform& to, const RigidTransform& from);

// Perturbations, covariances and twists of transforms that are derived from another one (README, section 5): the matrix
// J with which a perturbation xi of X becomes J xi, to first order, of the derived transform. A covariance P becomes
// J P J^T and a twist V becomes J V.
Matrix6d JacobianOfProduct(const Eigen::Matrix3d& left_rotation);  // Jacobian of A X, A constant with this rotation
Matrix6d JacobianOfInverse(const RigidTransform& transform);       // Jacobian of X^-1, at X = transform

// Angle of a^-1 b in radians, [0, pi].
double RotationAngle(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b);

}  // namespace evpose
