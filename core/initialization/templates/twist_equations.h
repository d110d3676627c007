// SPDX-License-Identifier: Apache-2.0

// Normal equations of the twist of an object, from velocities of its edges (core/initialization/README.md, equation
// (9)).
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>

#include "core/geometry/rigid_transform.h"

namespace evpose {

// Prior standard deviations per axis. Validated by initializer_test and template_search_test, which bound both from
// below.
struct TwistPrior {
  double velocity_px_per_s = 2000.0;        // fast for an object that fills the image
  double angular_velocity_rad_per_s = 6.0;  // about one turn per second
};

struct TwistEstimate {
  Vector6d twist = Vector6d::Zero();  // dT/dt = v in m/s, dR/dt = [w]x R with w in rad/s
  Matrix6d covariance = Matrix6d::Zero();
};

struct TwistEquations {
  Matrix6d information = Matrix6d::Zero();
  Vector6d right_side = Vector6d::Zero();

  // `m_per_px` is the size of a pixel at the object.
  void AddPrior(const TwistPrior& prior, double m_per_px) {
    const double velocity_m_per_s = prior.velocity_px_per_s * m_per_px;
    information.diagonal().head<3>().setConstant(1.0 / (velocity_m_per_s * velocity_m_per_s));
    information.diagonal().tail<3>().setConstant(1.0 /
                                                 (prior.angular_velocity_rad_per_s * prior.angular_velocity_rad_per_s));
  }
  // row . twist is measured.
  void Add(const Vector6d& row, double measured, double weight) {
    information += weight * row * row.transpose();
    right_side += weight * measured * row;
  }
  TwistEstimate Solve() const {
    const auto solver = information.ldlt();
    TwistEstimate estimate;
    estimate.twist = solver.solve(right_side);
    estimate.covariance = solver.solve(Matrix6d::Identity());
    return estimate;
  }
};

}  // namespace evpose
