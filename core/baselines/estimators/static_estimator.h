// SPDX-License-Identifier: Apache-2.0

// Published estimator of one static pose per window, for comparison.
#pragma once

#include <memory>

#include "core/baselines/estimators/line_fit.h"
#include "core/estimation/estimator.h"

namespace evpose {

// Options of the static estimators of the paper (Sec. III-C and III-D). The values of the paper and of its code are not
// tuned. The others are validated by estimators_test, in which each estimator has to follow a cube; `evpose bench
// tracking` runs with them.
struct StaticOptions {
  double distance_px = 8.0;            // pixels, d_t: largest distance of an event from its line; value of the paper
  double released_distance_px = 10.0;  // pixels, d_t of the released code
  double midpoint_ratio = 0.5;         // d_m: distance to the midpoint over the projected length; value of the paper
  double two_lines_px = 3.0;  // pixels, d_a: an event this close to two lines is rejected; the paper gives no value
  // Re-weighting steps of S and of M, each; both converge in fewer.
  int max_iterations = 20;
  double tolerance_px = 5e-3;  // pixels; re-weighting ends when no distance changes by more
  // Events per window, downsampled uniformly; with more the error is systematic.
  int max_events = 4000;
};

// Makes a static estimator with the default options. `camera` must be valid.
std::unique_ptr<WindowEstimator> MakeStaticEstimator(LineFitMethod method, LineFitFormulas formulas,
                                                     const CameraModel& camera);

}  // namespace evpose
