// The first pose from raw events: a tracker that is told nothing is started at random times of simulated recordings.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/simulation/simulator.h"
#include "core/tracking/tracker_options.h"

namespace evpose {

struct EventTrialOptions {
  SimulatedObject object = SimulatedObject::kCube;
  int num_starts = 200;
  int64_t recording_us = 5'000'000;  // the starts are spread over it
  double noise_ratio = 0.05;         // of the events, made by nothing
  double speed_scale = 1.0;          // of the standard scene
  uint64_t seed = 1;                 // of the scene and the starts
  int64_t watch_us = 250'000;        // that each start is followed for
  TrackerOptions tracker;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// A pose is right within 2 deg and 2 % of depth, modulo the object's symmetries.
struct EventTrial {
  int64_t t_start_us = 0;
  int64_t t_first_pose_us = -1;  // events until the first TRACKING pose was given; -1: none
  bool is_first_right = false;
  double reprojection_px = 0.0;  // of the first pose: mean over the end points of the lines that are visible
  int64_t wrong_us = 0;          // the longest stretch of wrong TRACKING poses
  uint64_t attempts = 0;
};

// One recording, all its starts. `on_trial` hears of each as it ends.
absl::StatusOr<std::vector<EventTrial>> RunEventTrials(
    const EventTrialOptions& options, const std::function<void(const EventTrial&)>& on_trial = nullptr);

struct EventTrialSummary {
  int num_starts = 0;
  int num_right = 0;                  // first pose right, from at most 50 ms of events
  int num_wrong = 0;                  // first pose wrong
  double first_pose_median_ms = 0.0;  // of those that came
  double reprojection_mean_px = 0.0;  // of the right ones
  int64_t longest_wrong_us = 0;
};
EventTrialSummary Summarize(const std::vector<EventTrial>& trials);

// The object is tracked for half a second, is gone for `absence_us`, with nothing but noise, and is back elsewhere.
// Microseconds of sensor time from its return to the first TRACKING pose that is right; -1: none within watch_us.
absl::StatusOr<int64_t> RunReturnTrial(const EventTrialOptions& options, int64_t absence_us);

}  // namespace evpose
