// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/motion_prior.h"

#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

double Squared(double x) { return x * x; }

}  // namespace

absl::Status InitialPoseOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckPositive("lateral_px", lateral_px));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("depth_ratio", depth_ratio));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("rotation_rad", rotation_rad));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("velocity_px_per_s", velocity_px_per_s));
  return CheckPositive("angular_velocity_rad_per_s", angular_velocity_rad_per_s);
}

absl::Status MotionPriorOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckPositive("linear_acceleration_density", linear_acceleration_density));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("angular_acceleration_density", angular_acceleration_density));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("turn_time_s", turn_time_s));
  return CheckRange("retry_noise_factor", retry_noise_factor, 1.0, 1e6);
}

MotionState Plus(const MotionState& state, const Vector12d& dx) {
  MotionState moved = state;
  moved.camera_from_object = Perturb(state.camera_from_object, dx.head<6>());
  moved.twist += dx.tail<6>();
  return moved;
}

Vector12d Minus(const MotionState& to, const MotionState& from) {
  Vector12d dx;
  dx.head<6>() = Difference(to.camera_from_object, from.camera_from_object);
  dx.tail<6>() = to.twist - from.twist;
  return dx;
}

MotionState InitialMotionState(const RigidTransform& camera_from_object, int64_t t_us, double focal_px,
                               const InitialPoseOptions& options) {
  const double depth_m = camera_from_object.translation_m.norm();
  const double m_per_px = depth_m / focal_px;
  // Depth is measured along the line of sight to the object's origin.
  const Eigen::Vector3d sight = camera_from_object.translation_m / depth_m;
  const Eigen::Matrix3d along = sight * sight.transpose();
  const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - along;

  MotionState state;
  state.t_us = t_us;
  state.camera_from_object = camera_from_object;
  state.covariance.block<3, 3>(0, 0) =
      Squared(options.lateral_px * m_per_px) * across + Squared(options.depth_ratio * depth_m) * along;
  state.covariance.block<3, 3>(3, 3).diagonal().setConstant(Squared(options.rotation_rad));
  state.covariance.block<3, 3>(6, 6).diagonal().setConstant(Squared(options.velocity_px_per_s * m_per_px));
  state.covariance.block<3, 3>(9, 9).diagonal().setConstant(Squared(options.angular_velocity_rad_per_s));
  return state;
}

MotionState Predict(const MotionState& state, int64_t t_us, const MotionPriorOptions& options, double noise_factor) {
  const double dt = static_cast<double>(t_us - state.t_us) * 1e-6;
  MotionState predicted = state;
  predicted.t_us = t_us;
  predicted.camera_from_object = Perturb(state.camera_from_object, state.twist * dt);

  Matrix12d& p = predicted.covariance;
  const Matrix6d pv = state.covariance.topRightCorner<6, 6>();
  const Matrix6d vv = state.covariance.bottomRightCorner<6, 6>();
  p.topLeftCorner<6, 6>() += dt * (pv + pv.transpose()) + dt * dt * vv;
  p.topRightCorner<6, 6>() += dt * vv;
  p.bottomLeftCorner<6, 6>() = p.topRightCorner<6, 6>().transpose();

  const double depth_m = state.camera_from_object.translation_m.norm();
  // core/geometry/README.md, equation (3).
  const double linear = noise_factor * (Squared(options.linear_acceleration_density * depth_m) +
                                        state.twist.head<3>().squaredNorm() / options.turn_time_s);
  const double angular = noise_factor * (Squared(options.angular_acceleration_density) +
                                         state.twist.tail<3>().squaredNorm() / options.turn_time_s);
  for (int i = 0; i < 6; ++i) {
    const double q = i < 3 ? linear : angular;
    p(i, i) += q * dt * dt * dt / 3.0;
    p(i, i + 6) += q * dt * dt / 2.0;
    p(i + 6, i) += q * dt * dt / 2.0;
    p(i + 6, i + 6) += q * dt;
  }
  return predicted;
}

void AddPriorEquations(const MotionState& state, const MotionState& predicted, const Matrix12d& information,
                       Matrix12d& hessian, Vector12d& gradient) {
  const Vector12d x = Minus(state, predicted);
  // A perturbation dtheta of the state changes the rotational part of x by the inverse left Jacobian of x times dtheta.
  // The Jacobian J of the whole of x is the identity but for this block, so that the products with J change three rows
  // and three columns only. They are sums of three terms in a fixed order, unlike the general product of this size.
  const Eigen::Matrix3d jacobian = LeftJacobianInverseSo3(x.segment<3>(3));
  Matrix12d product = information;
  for (int k = 0; k < 3; ++k) {
    product.row(3 + k) =
        jacobian(0, k) * information.row(3) + jacobian(1, k) * information.row(4) + jacobian(2, k) * information.row(5);
  }
  hessian.leftCols<3>() += product.leftCols<3>();
  hessian.rightCols<6>() += product.rightCols<6>();
  for (int k = 0; k < 3; ++k) {
    hessian.col(3 + k) +=
        jacobian(0, k) * product.col(3) + jacobian(1, k) * product.col(4) + jacobian(2, k) * product.col(5);
  }
  const Vector12d residual = information * x;
  gradient.head<3>() += residual.head<3>();
  gradient.tail<6>() += residual.tail<6>();
  for (int k = 0; k < 3; ++k) {
    gradient[3 + k] += jacobian(0, k) * residual[3] + jacobian(2, k) * residual[5] + jacobian(1, k) * residual[4];
  }
}

}  // namespace evpose
