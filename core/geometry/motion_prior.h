// SPDX-License-Identifier: Apache-2.0

// The constant-velocity motion prior: predicted pose and twist with their covariance (core/geometry/README.md, section
// 2).
#pragma once

#include <cstdint>

#include "absl/status/status.h"
#include "core/base/state_io.h"
#include "core/events/event.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

using Vector12d = Eigen::Matrix<double, 12, 1>;
using Matrix12d = Eigen::Matrix<double, 12, 12>;

// Standard deviations of a first pose that the user gives. Most are in image units, so that they hold for every size
// and distance of the object. Validated by tracker_test: the motions of TracksConstantTwist, up to 1400 px/s and 12
// rad/s, start with an unknown velocity, and the first pose of AnInaccurateFirstPoseIsCorrected has errors of about one
// standard deviation.
struct InitialPoseOptions {
  double lateral_px = 2.0;            // across the line of sight: the accuracy of a pose set by hand or from lines
  double depth_ratio = 0.01;          // along the line of sight, of the distance
  double rotation_rad = 0.015;        // about 1 deg
  double velocity_px_per_s = 2000.0;  // motion unknown: fast for an object that fills the image
  double angular_velocity_rad_per_s = 6.0;  // about one turn per second

  absl::Status Validate() const;
};

// White acceleration: the twist performs a random walk with these densities (core/geometry/README.md, equation (3)).
// Where a field does not say more, it is validated by the position errors, losses and NEES of `evpose bench tracking`
// at up to 2.83 m/s and after rests (core/experiments/RESULTS.md, Tracking). For slower objects motion_adaptation.h
// reduces the densities.
struct MotionPriorOptions {
  // Depths per second^1.5, relative to the depth, because the motion in the image counts. In 10 ms the velocity changes
  // by 0.034 depths/s, 34 px/s at f = 1000 px. Faster changes are found by the retry (retry_noise_factor).
  double linear_acceleration_density = 0.34;
  // Radians per second^1.5: in 10 ms the angular velocity changes by 0.24 rad/s, as of an object turned by hand.
  double angular_acceleration_density = 2.4;
  // Seconds in which a velocity changes by its own magnitude, in addition to both densities: an object that moves fast
  // inside the field of view must soon turn round.
  double turn_time_s = 0.5;
  // Factor on the process noise, the squares of both densities, for the second fit of a window after a fall of the
  // explained ratio (core/estimation/README.md, section 5): the standard deviation of a change is 16 times as large,
  // 540 px/s in 10 ms at f = 1000 px. Validated on a resting object that accelerates to 0.7 m/s at once. With a larger
  // factor the prediction restricts the second fit less, so that it may follow other edges.
  double retry_noise_factor = 250.0;

  absl::Status Validate() const;
};

// Pose and twist with their joint covariance, in the order [translation, rotation, linear velocity, angular velocity].
// The perturbation is on the left (rigid_transform.h): dT/dt = v, dR/dt = [w]x R.
struct MotionState {
  int64_t t_us = 0;
  RigidTransform camera_from_object;
  Vector6d twist = Vector6d::Zero();  // m/s, rad/s
  Matrix12d covariance = Matrix12d::Zero();

  static void VisitState(auto& archive, auto& self) {
    auto& [t_us, camera_from_object, twist, covariance] = self;
    archive(InRange(t_us, -kMaxStateTimeUs, kMaxStateTimeUs), camera_from_object, Finite(twist), Finite(covariance));
    constexpr double kMax = 1e9;  // m, m/s and rad/s: no real motion, and its squares do not overflow
    archive.Check(camera_from_object.translation_m.cwiseAbs().maxCoeff() < kMax && twist.cwiseAbs().maxCoeff() < kMax,
                  "a pose or twist is larger than 1e9");
  }
};

// Plus() perturbs pose and twist by dx in this tangent space and keeps time and covariance; Minus() is the dx with
// Plus(from, dx) = to.
MotionState Plus(const MotionState& state, const Vector12d& dx);
Vector12d Minus(const MotionState& to, const MotionState& from);

// The state at t_us of a pose that the user gives, with twist 0. `focal_px` converts pixels to angles.
MotionState InitialMotionState(const RigidTransform& camera_from_object, int64_t t_us, double focal_px,
                               const InitialPoseOptions& options);

// The predicted state at t_us >= state.t_us (core/geometry/README.md, equations (1) to (3)). `noise_factor` multiplies
// the spectral density of the acceleration.
MotionState Predict(const MotionState& state, int64_t t_us, const MotionPriorOptions& options,
                    double noise_factor = 1.0);

// Adds the Gauss-Newton Hessian and the gradient of x^T information x / 2, x = Minus(state, predicted), with respect to
// a perturbation of `state` (core/geometry/README.md, section 2). `information` is symmetric.
void AddPriorEquations(const MotionState& state, const MotionState& predicted, const Matrix12d& information,
                       Matrix12d& hessian, Vector12d& gradient);

}  // namespace evpose
