// SPDX-License-Identifier: Apache-2.0

// Errors of a pose that have the same cause in many windows, so that no filter averages them out: the constants of the
// sensor are known only approximately (core/estimation/README.md, section 10). They are considered in the published
// covariance, as parameters of a Schmidt-Kalman filter, and do not change the pose.
#pragma once

#include "absl/status/status.h"
#include "core/base/state_io.h"
#include "core/geometry/motion_prior.h"

namespace evpose {

// Standard deviations of the constants among sensors. SensorProfile::uncertainty is the share of them that remains with
// a profile. They were validated by the NEES of objects on sensors with thresholds from 0.15 to 0.45, bandwidths from
// 600 Hz to 10 kHz, refractory times from 50 to 400 us and lenses that blur by 0.3 to 1.2 px
// (tests/bench/consistency.py).
struct SystematicOptions {
  // Relative error of the edge bias (edge_bias.h), which is proportional to the blur.
  double edge_bias_ratio = 0.35;
  // Pixels by which events lag behind their edge, whatever its speed: thresholds of ON and OFF events differ, and with
  // them the lag of the first event after a reversal.
  double lag_px = 0.1;
  // Microseconds by which the time stamps are late, beyond SensorProfile::latency_us.
  double latency_us = 60.0;

  // INVALID_ARGUMENT with the name of the invalid field.
  absl::Status Validate() const;
};

// Change of the gradient of the normal equations of a window (core/estimation/README.md, equation (8)) if all edge
// biases were larger by 100 %, and if the events of all lines lagged by 1 px.
struct SystematicGradients {
  Vector12d by_edge_bias = Vector12d::Zero();
  Vector12d by_lag = Vector12d::Zero();
};

class SystematicError {
 public:
  // Follows the filter over `num_windows` windows like this one, of `duration_s`, equation (15). `prior_information` is
  // that of the predicted state, `covariance` that of the estimate.
  void Update(const Matrix12d& prior_information, double duration_s, const Matrix12d& covariance,
              const SystematicGradients& gradients, int num_windows);

  // Covariance of the systematic error of a pose that moves with `twist`, equation (16). `uncertainty` is that of the
  // sensor profile; `options` must be valid.
  Matrix6d Covariance(const SystematicOptions& options, double uncertainty, const Vector6d& twist) const;

  static void VisitState(auto& archive, auto& self) {
    auto& [by_edge_bias, by_lag] = self;
    archive(Finite(by_edge_bias), Finite(by_lag));
  }

 private:
  // Change of the state per unit of each constant.
  Vector12d by_edge_bias_ = Vector12d::Zero();
  Vector12d by_lag_ = Vector12d::Zero();
};

}  // namespace evpose
