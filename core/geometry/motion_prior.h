// SPDX-License-Identifier: Apache-2.0

// The constant-velocity prior: where the object is expected, and how surely (core/geometry/README.md, section 2).
#pragma once

#include <cstdint>

#include "absl/status/status.h"
#include "core/base/state_io.h"
#include "core/events/event.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

using Vector12d = Eigen::Matrix<double, 12, 1>;
using Matrix12d = Eigen::Matrix<double, 12, 12>;

// How far a pose that somebody gave may be off, one standard deviation. Image units scale with object and distance.
struct InitialPoseOptions {
  double lateral_px = 2.0;                  // sideways, in the image: what a hand-made or line-based first pose reaches
  double depth_ratio = 0.01;                // of the distance
  double rotation_rad = 0.015;              // about 1 deg
  double velocity_px_per_s = 2000.0;        // nothing is known of the motion: fast for an object that fills the image
  double angular_velocity_rad_per_s = 6.0;  // about one turn per second

  absl::Status Validate() const;
};

// White acceleration (core/geometry/README.md, section 2): the twist does a random walk of this strength.
struct MotionPriorOptions {
  // Depths per second^1.5: in 10 ms the velocity changes by 0.034 depths/s, 35 px/s at f = 1000 px. Relative to the
  // depth, so that the image motion counts. What is quicker, a second try follows (retry_noise_factor).
  double linear_acceleration_density = 0.34;
  // Radians per second^1.5: in 10 ms the angular velocity changes by 0.24 rad/s, as in a hand's turn.
  double angular_acceleration_density = 2.4;
  // Seconds in which a velocity changes by as much as itself, on top of both: what moves fast within a view turns in
  // it.
  double turn_time_s = 0.5;
  // Process noise of the second try after a fall of the explained share, as a factor (core/estimation/README.md,
  // section 5).
  double retry_noise_factor = 250.0;

  absl::Status Validate() const;
};

// Pose and twist with their joint covariance. The order is [translation, rotation, linear velocity, angular velocity];
// the perturbation is on the left (rigid_transform.h), dT/dt = v and dR/dt = w^ R.
struct MotionState {
  int64_t t_us = 0;
  RigidTransform camera_from_object;
  Vector6d twist = Vector6d::Zero();  // m/s, rad/s
  Matrix12d covariance = Matrix12d::Zero();

  static void VisitState(auto& archive, auto& self) {
    auto& [t_us, camera_from_object, twist, covariance] = self;
    archive(InRange(t_us, -kMaxStateTime_us, kMaxStateTime_us), camera_from_object, Finite(twist), Finite(covariance));
    // No object is there or as fast; what follows from such numbers does not overflow.
    constexpr double kMax = 1e9;
    archive.Check(camera_from_object.translation_m.cwiseAbs().maxCoeff() < kMax && twist.cwiseAbs().maxCoeff() < kMax,
                  "a motion that nothing makes");
  }
};

// x <- x + dx in that tangent space, and the dx with Plus(from, dx) = to. The covariance stays.
MotionState Plus(const MotionState& state, const Vector12d& dx);
Vector12d Minus(const MotionState& to, const MotionState& from);

// The state of a pose that somebody gave for t_us. `focal_px` turns pixels into angles.
MotionState InitialMotionState(const RigidTransform& camera_from_object, int64_t t_us, double focal_px,
                               const InitialPoseOptions& options);

// The state at t_us >= state.t_us under white acceleration; `noise_factor` multiplies the noise's spectral density.
MotionState Predict(const MotionState& state, int64_t t_us, const MotionPriorOptions& options,
                    double noise_factor = 1.0);

// Adds what a least-squares step at `state` sees of x^T information x / 2, x = Minus(state, predicted): Hessian and
// gradient by a further perturbation of `state`. `information` is symmetric.
void AddPriorEquations(const MotionState& state, const MotionState& predicted, const Matrix12d& information,
                       Matrix12d& hessian, Vector12d& gradient);

}  // namespace evpose
