// SPDX-License-Identifier: Apache-2.0

// Benchmark of the tracker and of the published estimators on the scenarios: accuracy, losses, consistency of the
// covariance, processor time.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/baselines/estimators/estimator_kind.h"
#include "core/experiments/tracking/tracking_scenarios.h"
#include "core/experiments/tracking/tracking_score.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {

// A tracker configuration that is measured.
struct TrackingSubject {
  enum class Kind {
    kDefault,    // searches for its first pose, and again after a loss
    kPublished,  // is given the true first pose; a lost object stays lost, as in its paper
    kOracle,     // tracking_oracle.h
  };
  std::string name;  // name of `evpose replay --estimator`, or "oracle"
  std::string description;
  Kind kind = Kind::kPublished;
  Estimator estimator = Estimator::kMixture;
};
std::vector<TrackingSubject> TrackingSubjects();

// The defaults are settings of the benchmark and not tuned.
struct TrackingBenchOptions {
  std::vector<std::string> scenarios;   // empty: all
  std::vector<std::string> estimators;  // names of TrackingSubjects(); empty: all
  int num_seeds = 5;                    // [1, 1000]; seeds 1, 2, ... determine pixels, noise and textures
  int num_paths = 5;                    // [1, 1000]; each seed is run on each of the paths 1, 2, ...
  int64_t max_duration_us = 0;          // microseconds of a recording; 0: duration of the scenario
  // Directory of the recordings, with a subdirectory for each run; a recording of the same simulation is used again.
  // Empty: every run is simulated and none is stored.
  std::string recordings;
  TrackerOptions tracker;  // options for all estimators; the estimator factory is replaced

  // INVALID_ARGUMENT names the field or lists the known names.
  absl::Status Validate() const;
};

struct TrackingBenchRow {
  std::string scenario;
  std::string estimator;
  std::vector<TrackingScore> scores;  // by seed, then by path
  TrackingSubject::Kind kind = TrackingSubject::Kind::kPublished;
  TrackingSummary summary;
  // Comparison of the default estimator with its targets, and its position error with half of that of static-mm, if
  // that is measured and keeps the object. Empty for the other estimators.
  std::vector<TargetCheck> target_checks;
};

// The rows of one scenario.
struct TrackingBenchBlock {
  TrackingScenario scenario;
  int64_t duration_us = 0;
  double mean_event_rate_hz = 0.0;
  Trajectory truth;  // true trajectory of the first run
  std::vector<TrackingBenchRow> rows;
};

// Called with the finished share of the work, in [0, 1], and a description of the present step; returning false ends
// the work with CANCELLED. May be null.
using TrackingBenchProgress = std::function<bool(double done_ratio, const std::string& text)>;

// Runs the benchmark. The result is a function of the options, except for the processor times. `on_block` is called
// after every scenario. Errors: those of Validate() and of PlayRun() (tracking_recordings.h).
absl::Status RunTrackingBench(const TrackingBenchOptions& options,
                              const std::function<void(const TrackingBenchBlock&)>& on_block,
                              const TrackingBenchProgress& on_progress = nullptr);

}  // namespace evpose
