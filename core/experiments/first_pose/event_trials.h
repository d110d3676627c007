// SPDX-License-Identifier: Apache-2.0

// First poses from raw events: a tracker without a given pose is started at random times of simulated recordings.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/simulation/scene.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {

// The detectors that turn events into lines: "planes", the space-time planes of the paper's Sec. III-A, which the
// tracker uses by default, and "lsd", LSD on an image of accumulated events (core/baselines/first_pose/lsd_detector.h).
std::vector<std::string> LineDetectorNames();

// The defaults are settings of the benchmark and not tuned. With 200 starts the standard error of a share is at most
// 3.5 %.
struct EventTrialOptions {
  SimulatedObject object = SimulatedObject::kCube;
  std::string camera = "evk4";       // "evk4" or "vga" (SimulatedCameraNames)
  int num_starts = 200;              // [1, 1000000] starts
  int64_t recording_us = 5'000'000;  // microseconds of the recording, over which the starts are distributed
  double noise_ratio = 0.05;         // share of noise among the events, [0, 0.9]
  double speed_scale = 1.0;          // factor on the speed of the standard scene
  uint64_t seed = 1;                 // determines the scene and the starts
  int64_t watch_us = 250'000;        // microseconds for which each start is followed, at least 1000
  std::string detector = "planes";   // line detector, one of LineDetectorNames()
  TrackerOptions tracker;            // its line detector is replaced by `detector`

  // INVALID_ARGUMENT names the field.
  absl::Status Validate() const;
};

// Result of one start. A wrong pose is one that is reported as TRACKING and is not right (PoseError::is_right).
struct EventTrial {
  int64_t t_start_us = 0;
  // Time of the last event before the first TRACKING pose was reported; -1: none.
  int64_t t_first_pose_us = -1;
  bool is_first_right = false;
  double reprojection_px = 0.0;  // error of the first pose: mean over the end points of the visible lines, pixels
  int64_t wrong_us = 0;          // longest interval with wrong poses
  uint64_t attempts = 0;         // searches for the pose

  // Whether the first pose is right and needed at most 50 ms of events.
  bool is_right_in_time() const;
};

// Called with the finished share of the work, in [0, 1]; returning false ends the work with CANCELLED. May be null.
using TrialProgress = std::function<bool(double done_ratio)>;

// Simulates one recording and processes all its starts. A function of the options. Errors: those of Validate().
absl::StatusOr<std::vector<EventTrial>> RunEventTrials(const EventTrialOptions& options,
                                                       const TrialProgress& on_progress = nullptr);

struct EventTrialSummary {
  int num_starts = 0;
  int num_right = 0;                  // starts with a right first pose in time
  int num_wrong = 0;                  // starts with a wrong first pose
  int num_none = 0;                   // starts without a pose
  double first_pose_median_ms = 0.0;  // median of the reported first poses; NaN if there are none
  double reprojection_mean_px = 0.0;  // mean of the right first poses, in time or not; NaN if there are none
  int64_t longest_wrong_us = 0;
};
EventTrialSummary Summarize(absl::Span<const EventTrial> trials);

struct ReturnTrial {
  uint64_t seed = 0;
  bool was_tracked = false;  // the last pose before the object left was TRACKING and right
  // Microseconds from its return to the first right TRACKING pose; -1: none within watch_us.
  int64_t tracked_us = -1;
  int64_t lingering_us = 0;  // microseconds of TRACKING poses after it had left
  int64_t wrong_us = 0;      // longest interval with wrong poses after its return
};

// The object is tracked for half a second, is absent for `absence_us` with noise only, and returns elsewhere for
// watch_us. `num_starts` and `recording_us` are ignored. Errors: those of Validate().
absl::StatusOr<ReturnTrial> RunReturnTrial(const EventTrialOptions& options, int64_t absence_us,
                                           const TrialProgress& on_progress = nullptr);

}  // namespace evpose
