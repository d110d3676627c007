// SPDX-License-Identifier: Apache-2.0

// The tracker and the published estimators on the scenarios: accuracy, losses, honesty, speed.
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
#include "core/tracking/tracker_options.h"

namespace evpose {

// One that is measured.
struct TrackingSubject {
  enum class Kind {
    kDefault,    // finds its first pose itself, and the object again after a loss
    kPublished,  // is given the true first pose, and what it loses stays lost, as in its paper
    kOracle,     // tracking_oracle.h
  };
  std::string name;  // as `evpose replay --estimator` has it, or "oracle"
  std::string description;
  Kind kind = Kind::kPublished;
  Estimator estimator = Estimator::kMixture;
};
std::vector<TrackingSubject> TrackingSubjects();

struct TrackingBenchOptions {
  std::vector<std::string> scenarios;   // empty: all
  std::vector<std::string> estimators;  // names of TrackingSubjects(); empty: all
  int num_seeds = 5;                    // [1, 1000]; seeds 1, 2, ... of pixels, noise and textures
  int num_paths = 5;                    // [1, 1000]; each seed on each of the paths 1, 2, ...
  int64_t max_duration_us = 0;          // of a recording; 0: the scenario's
  // A directory for the recordings, one below it for each run: those of the same simulations are used again. Empty:
  // every run is simulated, and none is kept.
  std::string recordings;
  TrackerOptions tracker;  // of all estimators; its `estimator` is theirs

  // INVALID_ARGUMENT naming the field, or listing the known names.
  absl::Status Validate() const;
};

struct TrackingBenchRow {
  std::string scenario;
  std::string estimator;
  std::vector<TrackingScore> scores;  // seed by seed, and within it path by path
  TrackingSubject::Kind kind = TrackingSubject::Kind::kPublished;
  TrackingSummary summary;
  // Of the default estimator, beside its targets also: at most half of static-mm's position error, where that is
  // measured and keeps the object. Empty for the others.
  std::vector<TrackingVerdict> verdicts;
};

// The rows of one scenario.
struct TrackingBenchBlock {
  TrackingScenario scenario;
  int64_t duration_us = 0;
  double mean_event_rate_hz = 0.0;
  Trajectory truth;  // of the first run
  std::vector<TrackingBenchRow> rows;
};

// Told how much is done, [0, 1], and what is being done; returning false ends it, with CANCELLED. May be null.
using TrackingBenchProgress = std::function<bool(double done_ratio, const std::string& text)>;

// A function of the options, but for the processor times. `on_block` is told of every scenario that is done. Errors:
// as Validate(), and those of PlayRun() (tracking_recordings.h).
absl::Status RunTrackingBench(const TrackingBenchOptions& options,
                              const std::function<void(const TrackingBenchBlock&)>& on_block,
                              const TrackingBenchProgress& on_progress = nullptr);

}  // namespace evpose
