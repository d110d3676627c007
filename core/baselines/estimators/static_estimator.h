// SPDX-License-Identifier: Apache-2.0

// The published estimator of one static pose per window, for comparison.
#pragma once

#include <memory>

#include "core/baselines/estimators/estimator_kind.h"
#include "core/estimation/estimator.h"

namespace evpose {

// The paper's static fits (its Sec. III-C and III-D), for comparison.
struct StaticOptions {
  double distance_px = 8.0;            // d_t: farthest event of a line; the paper's value
  double released_distance_px = 10.0;  // d_t of its released code
  double midpoint_ratio = 0.5;         // d_m: distance to the midpoint, of the projected length; the paper's value
  double two_lines_px = 3.0;           // d_a: events this close to two lines are rejected; the paper gives none
  int max_iterations = 20;             // re-weightings of S and of M each; both converge in fewer
  double tolerance_px = 5e-3;          // re-weighting ends when no event's distance changes by more
  int max_events = 4000;               // events per window, evenly drawn; the error is systematic beyond
};

// `estimator` is one of the static or released ones.
std::unique_ptr<WindowEstimator> MakeStaticEstimator(Estimator estimator, const StaticOptions& options,
                                                     const CameraModel& camera);

}  // namespace evpose
