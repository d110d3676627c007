// SPDX-License-Identifier: Apache-2.0

// The line-SLAM style estimator that the published ones are compared with: an error-state Kalman filter on
// event-to-line distances, event by event, after Chamorro, Sola, Andrade-Cetto, "High-Speed Event Camera Tracking",
// BMVC 2020, and "Event-Based Line SLAM in Real Time", RA-L 2022, with a map that is known: the model.
#pragma once

#include <memory>

#include "core/estimation/estimator.h"
#include "core/geometry/motion_prior.h"

namespace evpose {

// The filter after Chamorro et al. (error_state_filter.h), for comparison.
struct ErrorStateFilterOptions {
  double sigma_px = 0.8;        // an event's distance to its line: as MixtureOptions' to start with, and not learned
  double gate_px = 8.0;         // farthest event of a line, before the test
  double two_lines_px = 3.0;    // events this close to two lines are rejected
  double gate_chi2 = 6.63;      // of the squared innovation over its variance: 99 %, one degree of freedom
  double injection_s = 100e-6;  // seconds: the lines are projected anew so often; 10 kHz in the published filter
  // So many events count as one (core/estimation/README.md, section 7). The published filter takes each for new, and
  // its covariance shrinks until the gate holds nothing but the noise.
  double events_per_information = 20.0;
  int max_events = 16'384;  // events per window, evenly drawn: all but in a flood
};

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

std::unique_ptr<WindowEstimator> MakeErrorStateFilter(const ErrorStateFilterOptions& options,
                                                      const CameraModel& camera);

}  // namespace evpose
