// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/rigid_transform.h"

#include <cmath>

#include "absl/status/status.h"
#include "absl/strings/str_format.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// Squared angle (rad^2) below which the closed forms of (theta - sin) / theta^3 and (1 - h cot h) / theta^2 lose digits
// by cancellation. The truncated Taylor series used there are exact to the last bits.
constexpr double kSeriesAngle2 = 0.0625;

// Coefficients of Hat(r) and Hat(r)^2 in the exponential and in its left Jacobian.
struct RodriguesCoefficients {
  double sin_over_angle;               // sin(theta) / theta
  double one_minus_cos_over_angle2;    // (1 - cos(theta)) / theta^2
  double angle_minus_sin_over_angle3;  // (theta - sin(theta)) / theta^3
};

RodriguesCoefficients ComputeRodriguesCoefficients(double angle2) {
  if (angle2 < kSeriesAngle2) {
    const double t = angle2;
    return {1.0 - t / 6.0 * (1.0 - t / 20.0 * (1.0 - t / 42.0 * (1.0 - t / 72.0 * (1.0 - t / 110.0)))),
            0.5 * (1.0 - t / 12.0 * (1.0 - t / 30.0 * (1.0 - t / 56.0 * (1.0 - t / 90.0 * (1.0 - t / 132.0))))),
            1.0 / 6.0 * (1.0 - t / 20.0 * (1.0 - t / 42.0 * (1.0 - t / 72.0 * (1.0 - t / 110.0 * (1.0 - t / 156.0)))))};
  }
  const double angle = std::sqrt(angle2);
  // 1 - cos(theta) = 2 sin^2(theta / 2) has no cancellation.
  const auto [sin_half, cos_half] = DeterministicSinCos(0.5 * angle);
  const double sin_angle = 2.0 * sin_half * cos_half;
  return {sin_angle / angle, 2.0 * sin_half * sin_half / angle2, (angle - sin_angle) / (angle2 * angle)};
}

// One Newton step towards the nearest rotation: reduces an orthogonality error e to the order of e^2.
Eigen::Matrix3d Orthonormalised(const Eigen::Matrix3d& rotation) {
  return 0.5 * rotation * (3.0 * Eigen::Matrix3d::Identity() - rotation.transpose() * rotation);
}

}  // namespace

Eigen::Quaterniond RigidTransform::Quaternion() const {
  Eigen::Quaterniond quaternion(rotation);
  quaternion.normalize();
  if (quaternion.w() < 0.0) quaternion.coeffs() = -quaternion.coeffs();
  return quaternion;
}

absl::StatusOr<RigidTransform> MakeRigidTransform(const Eigen::Vector3d& translation_m,
                                                  const Eigen::Quaterniond& quaternion) {
  if (!translation_m.allFinite()) {
    return absl::InvalidArgumentError("translation: every number must be finite");
  }
  if (!quaternion.coeffs().allFinite()) {
    return absl::InvalidArgumentError("quaternion: every number must be finite");
  }
  const double norm = quaternion.norm();
  if (!(std::abs(norm - 1.0) <= 1e-3)) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "quaternion: its norm is %.6g, but must be 1 to within 1e-3; normalise it (order x y z w)", norm));
  }
  return RigidTransform{quaternion.normalized().toRotationMatrix(), translation_m};
}

Eigen::Matrix3d Hat(const Eigen::Vector3d& v) {
  Eigen::Matrix3d hat;
  hat << 0.0, -v.z(), v.y(),  //
      v.z(), 0.0, -v.x(),     //
      -v.y(), v.x(), 0.0;
  return hat;
}

Eigen::Matrix3d ExpSo3(const Eigen::Vector3d& rotation_rad) {
  const RodriguesCoefficients c = ComputeRodriguesCoefficients(rotation_rad.squaredNorm());
  const Eigen::Matrix3d hat = Hat(rotation_rad);
  return Eigen::Matrix3d::Identity() + c.sin_over_angle * hat + c.one_minus_cos_over_angle2 * (hat * hat);
}

Eigen::Vector3d LogSo3(const Eigen::Matrix3d& rotation) {
  // The conversion goes through the quaternion, which uses the largest of four pivots and so has full precision near 0
  // and near pi.
  const Eigen::Quaterniond quaternion = RigidTransform{rotation, Eigen::Vector3d::Zero()}.Quaternion();
  const double sin_half = quaternion.vec().norm();
  if (sin_half < 1e-150) return 2.0 * quaternion.vec();  // smaller squares underflow in the norm
  return (2.0 * DeterministicAtan2(sin_half, quaternion.w()) / sin_half) * quaternion.vec();
}

Eigen::Matrix3d LeftJacobianSo3(const Eigen::Vector3d& rotation_rad) {
  const RodriguesCoefficients c = ComputeRodriguesCoefficients(rotation_rad.squaredNorm());
  const Eigen::Matrix3d hat = Hat(rotation_rad);
  return Eigen::Matrix3d::Identity() + c.one_minus_cos_over_angle2 * hat + c.angle_minus_sin_over_angle3 * (hat * hat);
}

Eigen::Matrix3d LeftJacobianInverseSo3(const Eigen::Vector3d& rotation_rad) {
  const double angle2 = rotation_rad.squaredNorm();
  const Eigen::Matrix3d hat = Hat(rotation_rad);
  double coefficient;  // (1 - h cot(h)) / theta^2, h = theta / 2
  if (angle2 < kSeriesAngle2) {
    const double t = angle2;
    coefficient = 1.0 / 12.0 + t * (1.0 / 720.0 + t * (1.0 / 30240.0 + t * (1.0 / 1209600.0 + t / 47900160.0)));
  } else {
    const double half = 0.5 * std::sqrt(angle2);
    const auto [sin_half, cos_half] = DeterministicSinCos(half);
    coefficient = (1.0 - half * cos_half / sin_half) / angle2;
  }
  return Eigen::Matrix3d::Identity() - 0.5 * hat + coefficient * (hat * hat);
}

RigidTransform ExpSe3(const Vector6d& tangent) {
  const Eigen::Vector3d rotation_rad = tangent.tail<3>();
  return {ExpSo3(rotation_rad), LeftJacobianSo3(rotation_rad) * tangent.head<3>()};
}

Vector6d LogSe3(const RigidTransform& transform) {
  const Eigen::Vector3d rotation_rad = LogSo3(transform.rotation);
  Vector6d tangent;
  tangent << LeftJacobianInverseSo3(rotation_rad) * transform.translation_m, rotation_rad;
  return tangent;
}

RigidTransform Perturb(const RigidTransform& transform, const Vector6d& xi) {
  return {Orthonormalised(ExpSo3(xi.tail<3>()) * transform.rotation), transform.translation_m + xi.head<3>()};
}

Vector6d Difference(const RigidTransform& to, const RigidTransform& from) {
  Vector6d xi;
  xi << to.translation_m - from.translation_m, LogSo3(to.rotation * from.rotation.transpose());
  return xi;
}

Matrix6d JacobianOfProduct(const Eigen::Matrix3d& left_rotation) {
  Matrix6d jacobian = Matrix6d::Zero();
  jacobian.topLeftCorner<3, 3>() = left_rotation;
  jacobian.bottomRightCorner<3, 3>() = left_rotation;
  return jacobian;
}

Matrix6d JacobianOfInverse(const RigidTransform& transform) {
  const Eigen::Matrix3d back = transform.rotation.transpose();
  Matrix6d jacobian = Matrix6d::Zero();
  jacobian.topLeftCorner<3, 3>() = -back;
  jacobian.topRightCorner<3, 3>() = -back * Hat(transform.translation_m);
  jacobian.bottomRightCorner<3, 3>() = -back;
  return jacobian;
}

double RotationAngle(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b) { return LogSo3(a.transpose() * b).norm(); }

}  // namespace evpose
