// SPDX-License-Identifier: Apache-2.0

// Event-by-event estimator of line-SLAM: an error-state Kalman filter on event-to-line distances, after Chamorro, Sola,
// Andrade-Cetto, "High-Speed Event Camera Tracking", BMVC 2020, and "Event-Based Line SLAM in Real Time", RA-L 2022.
// The map is known here: it is the model.
#pragma once

#include <memory>

#include "core/estimation/estimator.h"
#include "core/events/correlated_events.h"
#include "core/geometry/motion_prior.h"

namespace evpose {

// Options of the filter. gate_px and two_lines_px are those of StaticOptions. The defaults are validated by
// estimators_test, in which the filter has to follow a cube; `evpose bench tracking` without --estimators runs with
// them.
struct ErrorStateFilterOptions {
  double sigma_px = 0.8;      // pixels: standard deviation of the distance of an event from its line; fixed
  double gate_px = 8.0;       // pixels: largest distance of an event from its line, before the test
  double two_lines_px = 3.0;  // pixels: an event this close to two lines is rejected
  double gate_chi2 = 6.63;    // largest squared innovation over its variance: 99 %, one degree of freedom
  // Seconds between two projections of the lines and injections of the error; the published filter works at 10 kHz.
  double injection_s = 100e-6;
  // Number of events that carry the information of one independent event. The published filter treats all events as
  // independent; its covariance then shrinks until the gate contains only noise.
  double events_per_information = kCorrelatedEvents;
  int max_events = 16'384;  // events per window; more are downsampled uniformly
};

// Mean and covariance of pose and twist between two injections of the error into the state. A measurement is the scalar
// distance of an event from its line, d = d_0 + row . error + noise in pixels, and its expected value is zero.
class ErrorState {
 public:
  explicit ErrorState(const MotionState& state) : state_(state), error_(Vector12d::Zero()) {}

  // Expected distance in pixels at the present error.
  double ExpectedPx(double distance_px, const Vector12d& row) const { return distance_px + row.dot(error_); }
  // Variance of this distance due to the state, without the noise of the event, pixels^2.
  double VariancePx2(const Vector12d& row) const { return row.dot(state_.covariance * row); }
  // Performs one update. `distance_px` is the distance at zero error, `noise_px2` the variance of the noise of the
  // event.
  void Update(double distance_px, const Vector12d& row, double noise_px2);

  // Moves the state by the error and sets the error to zero.
  void Inject();
  const MotionState& state() const { return state_; }

 private:
  MotionState state_;
  Vector12d error_;
};

// Makes the filter for a tracker, with the default options. `camera` must be valid.
std::unique_ptr<WindowEstimator> MakeErrorStateFilter(const CameraModel& camera);

}  // namespace evpose
