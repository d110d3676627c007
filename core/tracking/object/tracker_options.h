// SPDX-License-Identifier: Apache-2.0

// Options of the tracker, with unit, default and reason of each.
#pragma once

#include "absl/status/status.h"
#include "core/contours/edge_elements.h"
#include "core/detection/line_detector.h"
#include "core/estimation/mixture_estimator.h"
#include "core/geometry/motion_prior.h"
#include "core/models/visibility.h"
#include "core/tracking/evidence/flash.h"
#include "core/tracking/evidence/health.h"
#include "core/windows/event_window.h"

namespace evpose {

// Search for the pose, at the start and after a loss (core/detection/README.md and core/initialization/README.md). The
// defaults are validated by tracker_initialization_test (times until a pose, numbers of searches, ambiguous poses),
// half_turns_test (near-symmetric poses), event_trials_test and `evpose bench initialization --from-events`: a right
// pose from at most 50 ms of events for 996 of 1000 starts, and no wrong one (core/experiments/RESULTS.md, The first
// pose). `evpose bench real` has slow objects and objects that are absent.
struct InitializationOptions {
  // False: every pose is given by the caller, as in the published method, and a lost object is not searched for.
  bool is_automatic = true;
  // Makes the line detector; empty: planes in space and time (plane_detector.h). core/baselines/first_pose has LSD.
  LineDetectorFactory detector_factory;
  // Microseconds of past events that a search uses: the time in which a slow object moves by a few pixels. max_events
  // bounds them, too.
  int64_t memory_us = 1'000'000;
  // Events kept per window and in total: bounds memory and time at any event rate.
  int max_window_events = 4096;
  int max_events = 200'000;
  // Events that a search requires: about as many as three lines of 100 px produce when they move by one pixel.
  int min_events = 400;
  // Microseconds of sensor time between searches: the first interval, and the longest one while too few lines are
  // detected. The longest interval bounds the delay until a returning object is searched for.
  int64_t retry_us = 5000;
  int64_t max_retry_us = 32'000;
  // The longest interval while lines are detected but no pose fits them: such a search takes about ten times longer
  // than the line detection, and must not delay the events behind it.
  int64_t max_no_pose_retry_us = 100'000;
  // Microseconds after the publication of a pose at which the search is repeated with more events; its poses become
  // competing hypotheses. A pose that the first search has missed is found within 100 ms.
  int64_t repeat_us = 20'000;
  int num_repeats = 2;
  // Maximum number of poses of one search that become hypotheses.
  int max_candidates = 4;
  // Standard deviations of the score difference at which the worse of two poses is rejected: a false alarm rate of
  // 3e-5, one-sided under the normal distribution.
  double decision_sigma = 4.0;
  // Standard deviation of the score difference that edges without events, and events without an edge in the model, can
  // cause, divided by the sum of the scores. In this sum the scores at painted lines are multiplied by 1/4
  // (core/tracking/README.md, equation (3)). At decision_sigma, poses are told apart by at least 2.4 % of the sum. The
  // README, section 2, has the models with which it was validated.
  double model_error_ratio = 0.006;
  // Events of a window on which two poses are compared; further ones are correlated with these.
  int max_compared_events = 1000;
  // Radians, and ratio of the distance to the camera: hypotheses closer than both are merged, because no line detector
  // resolves them.
  double merge_rad = 0.02;
  double merge_depth_ratio = 0.01;
  // Microseconds between tests of the generated rivals of a published pose (core/tracking/README.md, section 6), and
  // the number of tests. After ten of them it has been seen from several views or moves so little that nothing is new.
  int64_t rival_interval_us = 1'000'000;
  int num_rival_rounds = 10;
  // Radians: the angle by which tilted rivals are turned. Poses that are off by 8 to 15 degrees converge to the right
  // one from one of the four.
  double tilt_rad = 0.17;
  // Tilted rivals are tested when the view has turned by tilt_view_rad (radians) since the latest test, or by a third
  // of it while the mean residual has become tilt_residual_growth times its least value. The README, section 6, has the
  // model with which both were validated.
  double tilt_view_rad = 0.15;
  double tilt_residual_growth = 1.3;
  // Microseconds after which the best of several competing hypotheses is published, as AMBIGUOUS and with the others as
  // alternatives. By then the comparison of most distinguishable poses has been decided.
  int64_t undecided_us = 200'000;

  absl::Status Validate() const;
};

struct TrackerOptions : EstimatorOptions {
  TrackerOptions() {
    // Exactly the lines that are visible at the predicted pose. On ideal events of a tumbling cube a tolerance of 0.02
    // to 0.1 in either direction loses up to a fifth of the runs; without a tolerance no run is lost
    // (core/association/README.md, section 3).
    visibility.grazing_cosine = 0.0;
    // 9 degrees: grooves 15 px apart on a face seen from the front then are 2 px apart, as far as the events of each
    // spread. Their events would be given to the wrong ones while a face appears or disappears. Not validated
    // separately; the cube on a turntable of `evpose bench real` has such lines in every quarter turn.
    visibility.painted_cosine = 0.15;
  }

  // Makes the estimator of each hypothesis; empty: the mixture estimator. core/baselines/estimators has others.
  EstimatorFactory estimator_factory;
  WindowOptions windows;
  VisibilityOptions visibility;
  EdgeElementOptions elements;
  InitialPoseOptions initial;
  InitializationOptions initialization;
  MotionPriorOptions motion;
  HealthOptions health;
  FlashOptions flash;

  std::unique_ptr<WindowEstimator> MakeEstimator(const CameraModel& camera) const;

  // INVALID_ARGUMENT naming the group and the field that is wrong.
  absl::Status Validate() const;
};

}  // namespace evpose
