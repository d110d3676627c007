// SPDX-License-Identifier: Apache-2.0

// What the tracker can be told, with units, defaults and the reason for each.
#pragma once

#include "absl/status/status.h"
#include "core/estimation/mixture_estimator.h"
#include "core/geometry/motion_prior.h"
#include "core/models/visibility.h"
#include "core/tracking/health.h"
#include "core/windows/event_window.h"

namespace evpose {

// The search for the pose, at the start and after a loss (core/detection/README.md and core/initialization/README.md).
struct InitializationOptions {
  // False: the pose is only ever given, as in the published method; what is lost stays lost.
  bool is_automatic = true;
  // Microseconds of events that a search may look back on: what a slow object needs to move by a few pixels.
  int64_t memory_us = 200'000;
  // Events kept, of a window and in all: bounds memory and time in a flood.
  int max_window_events = 4096;
  int max_events = 200'000;
  // Events that a search needs: three lines of a hundred pixels that moved by one make as many.
  int min_events = 400;
  // Microseconds of sensor time between searches: the first one, and what it grows to while there are too few lines to
  // search with; a returning object waits no longer than this.
  int64_t retry_us = 5000;
  int64_t max_retry_us = 32'000;
  // The same while there are lines, of something else: a search in vain takes some ten times longer than a look for
  // lines, and must not keep the events behind it waiting.
  int64_t max_vain_retry_us = 100'000;
  // Microseconds after a pose was taken up at which the search is done again, with more events, and its hypotheses
  // challenge the pose: what the first search had overlooked is then found within 100 ms.
  int64_t review_us = 20'000;
  int num_reviews = 2;
  // Hypotheses of a search that the events are asked about.
  int max_candidates = 4;
  // Standard deviations by which the events must prefer one of two poses: 3e-5 one-sided under the normal.
  double decision_sigma = 4.0;
  // Microseconds after which the better of two poses that cannot be told apart is reported, as DEGRADED.
  int64_t undecided_us = 200'000;

  absl::Status Validate() const;
};

struct TrackerOptions : EstimatorOptions {
  TrackerOptions() {
    // Exactly what is visible at the predicted pose. On ideal events of a tumbling cube a slack of 0.02 to 0.1 to
    // either side loses up to a fifth of the runs, none none.
    visibility.grazing_cosine = 0.0;
  }

  // Makes the estimator of each hypothesis; empty: the mixture estimator. core/baselines/estimators has others.
  EstimatorFactory estimator_factory;
  WindowOptions windows;
  VisibilityOptions visibility;
  InitialPoseOptions initial;
  InitializationOptions initialization;
  MotionPriorOptions motion;
  HealthOptions health;

  std::unique_ptr<WindowEstimator> MakeEstimator(const CameraModel& camera) const;

  // INVALID_ARGUMENT naming the group and the field that is wrong.
  absl::Status Validate() const;
};

}  // namespace evpose
