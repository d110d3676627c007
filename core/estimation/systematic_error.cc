// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/systematic_error.h"

#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose {

absl::Status SystematicOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("edge_bias_ratio", edge_bias_ratio, 0.0, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("lag_px", lag_px, 0.0, 10.0));
  return CheckRange("latency_us", latency_us, 0.0, 10'000.0);
}

void SystematicError::Update(const Matrix12d& prior_information, double duration_s, const Matrix12d& covariance,
                             const SystematicGradients& gradients, int num_windows) {
  const auto follow = [&](const Vector12d& gradient, Vector12d& error) {
    const Vector12d by_events = covariance * gradient;
    for (int window = 0; window < num_windows; ++window) {
      Vector12d predicted = error;
      predicted.head<6>() += duration_s * error.tail<6>();
      error = covariance * Vector12d(prior_information * predicted) - by_events;
    }
    if (!error.allFinite()) error.setZero();
  };
  follow(gradients.by_edge_bias, by_edge_bias_);
  follow(gradients.by_lag, by_lag_);
}

Matrix6d SystematicError::Covariance(const SystematicOptions& options, double uncertainty,
                                     const Vector6d& twist) const {
  const Vector6d bias = uncertainty * options.edge_bias_ratio * by_edge_bias_.head<6>();
  const Vector6d lag = uncertainty * options.lag_px * by_lag_.head<6>();
  const Vector6d late = 1e-6 * uncertainty * options.latency_us * twist;
  return bias * bias.transpose() + lag * lag.transpose() + late * late.transpose();
}

}  // namespace evpose
