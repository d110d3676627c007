// SPDX-License-Identifier: Apache-2.0

// Benchmark of first poses without a prior on recordings of model files: single searches, and trackers that are started
// at many times.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "core/experiments/first_pose/start_cause.h"
#include "core/experiments/tracking/model_bench.h"
#include "core/initialization/templates/template_alignment.h"

namespace evpose {

// The defaults are settings of the benchmark and not tuned.
struct FirstPoseBenchOptions {
  ModelBenchOptions bench;  // models, recordings and tracker
  int num_starts = 20;      // of each recording, [1, 10000]; distributed evenly over it
  // Microseconds of events that a tracker receives after a start; [10'000, duration of the recording].
  int64_t watch_us = 400'000;
  bool explains = false;  // whether FirstPoseStart::explanation is set; not with `shown`
  // The model that the recordings show instead of the one that is searched for, which is then absent, so that every
  // pose is wrong. nullopt: the recordings show the model that is searched for.
  std::optional<BenchModel> shown;

  // INVALID_ARGUMENT names the field.
  absl::Status Validate() const;
};

// The template search on the events before one time.
struct SearchTrial {
  int64_t t_us = 0;  // end of the events
  bool has_moved = false;
  int num_poses = 0;
  // Index of the first returned pose from which tracking finds the true one: within 6 degrees and 3 % of the depth,
  // modulo the symmetries. -1: none.
  int rank = -1;
  double best_rotation_rad = 0.0;      // of the returned pose nearest to the truth by rotation
  std::vector<AlignmentScore> scores;  // of the returned poses
  double compute_s = 0.0;              // processor time
};

// Microseconds within which a first pose counts as found: the latest of the searches that start_cause.cc explains.
inline constexpr int64_t kFoundWithinUs = 300'000;

// A tracker that is started without a prior.
struct FirstPoseStart {
  int64_t t_start_us = 0;
  // Microseconds from the start until a point of the object has moved by 2 px in the image; -1: it never does.
  int64_t moved_us = -1;
  int64_t right_us = -1;         // until a right pose is reported as TRACKING; -1: never
  int64_t longest_wrong_us = 0;  // longest time with wrong poses as TRACKING (WrongTime)
  // The largest errors of these poses, each by itself, and the sensor time of the first one; -1: none is wrong.
  int64_t wrong_at_us = -1;
  PoseError wrong;
  uint64_t searches = 0;
  double compute_s = 0.0;  // processor seconds until the first right pose, or for all events
  ReportedStates states;   // of all events
  StartExplanation explanation;

  // Found: within kFoundWithinUs of the time at which the object has moved.
  bool is_found() const { return right_us >= 0 && moved_us >= 0 && right_us - moved_us <= kFoundWithinUs; }
};

struct FirstPoseBenchRow {
  BenchModel model;
  std::string error;           // why the model cannot be tracked; empty if it can
  double preparation_s = 0.0;  // processor seconds for the views of the model
  size_t num_views = 0;
  std::vector<SearchTrial> trials;     // of all seeds
  std::vector<FirstPoseStart> starts;  // of all seeds
};

// The result is a function of the options and the files, except for the processor times. `on_row` is called after each
// model. Errors: those of Validate() and of PlayRun(); a reference that cannot be read.
absl::Status RunFirstPoseBench(const FirstPoseBenchOptions& options,
                               const std::function<void(const FirstPoseBenchRow&)>& on_row,
                               const ModelBenchProgress& on_progress = nullptr);

}  // namespace evpose
