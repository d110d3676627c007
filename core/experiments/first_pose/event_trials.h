// SPDX-License-Identifier: Apache-2.0

// The first pose from raw events: a tracker that is told nothing is started at random times of simulated recordings.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/simulation/scene.h"
#include "core/tracking/tracker_options.h"

namespace evpose {

// The detectors that turn events into lines: "planes", the space-time planes of the paper's Sec. III-A, which the
// tracker uses by default, and "lsd", LSD on an image of accumulated events (core/baselines/first_pose/lsd_detector.h).
std::vector<std::string> LineDetectorNames();

struct EventTrialOptions {
  SimulatedObject object = SimulatedObject::kCube;
  std::string camera = "evk4";       // or "vga" (SimulatedCameraNames)
  int num_starts = 200;              // [1, 1000000]
  int64_t recording_us = 5'000'000;  // the starts are spread over it
  double noise_ratio = 0.05;         // of the events, made by nothing, [0, 0.9]
  double speed_scale = 1.0;          // of the standard scene
  // The rest of the standard scene: none of these by default.
  MotionProfile motion_profile = MotionProfile::kSmooth;
  BackgroundOptions background;
  LightOptions light;
  OccluderOptions occluder;
  uint64_t seed = 1;                // of the scene and the starts
  int64_t watch_us = 250'000;       // that each start is followed for, at least 1000
  std::string detector = "planes";  // of the lines, or "lsd" (LineDetectorNames)
  TrackerOptions tracker;           // its line detector is replaced by `detector`

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Wrong is a pose that is reported as TRACKING and not right (PoseError::is_right).
struct EventTrial {
  int64_t t_start_us = 0;
  int64_t t_first_pose_us = -1;  // events until the first TRACKING pose was given; -1: none
  bool is_first_right = false;
  double reprojection_px = 0.0;  // of the first pose: mean over the end points of the lines that are visible
  int64_t wrong_us = 0;          // the longest stretch of wrong poses
  uint64_t attempts = 0;         // searches for the pose

  // Within what counts: right, from at most 50 ms of events.
  bool is_right_in_time() const;
};

// Told how much is done, [0, 1], as the work goes on; returning false ends it, with CANCELLED. May be null.
using TrialProgress = std::function<bool(double done_ratio)>;

// One recording, all its starts. A function of the options. Errors as Validate().
absl::StatusOr<std::vector<EventTrial>> RunEventTrials(const EventTrialOptions& options,
                                                       const TrialProgress& on_progress = nullptr);

struct EventTrialSummary {
  int num_starts = 0;
  int num_right = 0;                  // first pose right and in time
  int num_wrong = 0;                  // first pose wrong
  int num_none = 0;                   // no pose while the start was followed
  double first_pose_median_ms = 0.0;  // of the poses that came; NaN when none did
  double reprojection_mean_px = 0.0;  // of the right ones, in time or not; NaN when none is
  int64_t longest_wrong_us = 0;
};
EventTrialSummary Summarize(absl::Span<const EventTrial> trials);

struct ReturnTrial {
  uint64_t seed = 0;
  bool was_tracked = false;  // a right TRACKING pose was the last before the object left
  int64_t tracked_us = -1;   // events from its return to the first right TRACKING pose; -1: none within watch_us
  int64_t lingering_us = 0;  // TRACKING poses went on for so long after it had left
  int64_t wrong_us = 0;      // the longest stretch of wrong poses from its return on
};

// The object is tracked for half a second, is gone for `absence_us`, with nothing but noise, and is back elsewhere, for
// watch_us. `num_starts` and `recording_us` play no part. Errors as Validate().
absl::StatusOr<ReturnTrial> RunReturnTrial(const EventTrialOptions& options, int64_t absence_us,
                                           const TrialProgress& on_progress = nullptr);

}  // namespace evpose
