// SPDX-License-Identifier: Apache-2.0

// The line-SLAM style estimator that the published ones are compared with: an error-state Kalman filter on
// event-to-line distances, event by event, after Chamorro, Sola, Andrade-Cetto, "High-Speed Event Camera Tracking",
// BMVC 2020, and "Event-Based Line SLAM in Real Time", RA-L 2022, with a map that is known: the model.
#pragma once

#include "core/tracking/motion_prior.h"

namespace evpose {

// Mean and covariance of pose and twist, between two injections of the error into the state. A measurement is scalar:
// the distance of an event to its line, d = d_0 + row . error with noise, which on the line would be zero.
class ErrorState {
 public:
  explicit ErrorState(const MotionState& state) : state_(state), error_(Vector12d::Zero()) {}

  // Of the distance at the present error, pixels.
  double ExpectedPx(double distance_px, const Vector12d& row) const { return distance_px + row.dot(error_); }
  // The variance of that distance by the state's, without the event's own, pixels^2.
  double VariancePx2(const Vector12d& row) const { return row.dot(state_.covariance * row); }
  // One update with the distance at no error, and the variance of the event's noise, pixels^2.
  void Update(double distance_px, const Vector12d& row, double noise_px2);

  // Moves the state by the error, which is zero then.
  void Inject();
  const MotionState& state() const { return state_; }

 private:
  MotionState state_;
  Vector12d error_;
};

}  // namespace evpose
