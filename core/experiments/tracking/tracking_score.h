// SPDX-License-Identifier: Apache-2.0

// Scores of an estimator on a recording.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"
#include "core/evaluation/consistency.h"
#include "core/evaluation/evaluate.h"
#include "core/experiments/tracking/tracking_scenarios.h"
#include "core/models/object_model.h"
#include "core/tracking/tracker.h"

namespace evpose {

// Counts events in intervals of 10 ms from the beginning of the recording on.
class EventRate {
 public:
  // Microseconds. At 0.3 Mev/s an interval has 3000 events, so that chance changes its rate by 2 %.
  static constexpr int64_t kIntervalUs = 10'000;

  explicit EventRate(int64_t t_begin_us) : t_begin_us_(t_begin_us) {}
  void Add(absl::Span<const Event> events);
  // Returns the share of the intervals with more than 0.3 Mev/s in which poses are reported at 1 kHz, to 2 %; NaN
  // without such an interval. The first 50 ms, which the first pose may take, and the last interval are ignored.
  double ShareAtFullPoseRate(const std::vector<PoseEstimate>& poses) const;
  uint64_t num_events() const { return num_events_; }

 private:
  int64_t t_begin_us_;
  uint64_t num_events_ = 0;
  std::vector<uint32_t> counts_;
};

struct TrackingOutput {
  std::vector<PoseEstimate> poses;
  uint64_t losses = 0;     // losses that the tracker reported
  double compute_s = 0.0;  // seconds of processor time
};

struct TrackingScore {
  // Errors modulo the symmetries of the object. The coverage counts from the first event of the recording on: the time
  // before the first pose is not covered.
  Evaluation evaluation;
  // The larger of two numbers: the losses that the truth shows (Evaluation.losses) while the object is in view, and
  // those that the tracker reported. The object is in view if a quarter of the length of its lines, hidden ones
  // included, is projected into the image.
  uint64_t losses = 0;
  double first_pose_ms = 0.0;     // sensor time until the first good pose; NaN if there is none
  double full_rate_ratio = 0.0;   // EventRate::ShareAtFullPoseRate
  std::vector<double> nees;       // NEES of all published poses
  double wrong_tracking_s = 0.0;  // TRACKING was reported without a good pose
  double longest_wrong_tracking_s = 0.0;
  double right_untracked_s = 0.0;  // a good pose was reported with another state than TRACKING
  double compute_ratio = 0.0;      // processor time / sensor time
  // Errors of the poses, for charts and for the scores of model_bench. RunTrackingBench() keeps those of the first run
  // of a row.
  std::vector<TrajectoryError> errors;
};

// Scores the poses of a run; `truth` and `model` are those of the run. Errors: those of Evaluate().
absl::StatusOr<TrackingScore> ScoreTracking(const SimulationOptions& run, const ObjectModel& model,
                                            const Trajectory& truth, const EventRate& rate,
                                            const TrackingOutput& output);

// Summary over the runs of one scenario.
struct TrackingSummary {
  int num_runs = 0;
  // Means over the runs, NaN if a run has no pose; sums of the losses and of the times with a wrong pose or state; the
  // maximum of the largest errors and of the longest time. The number of poses and the lists are not set.
  TrackingScore overall;
  Consistency consistency;  // consistency of the poses of all runs
  // The worst run's coverage, position_rmse_of_depth, rotation_median_rad and rotation_p95_rad, each by itself. Other
  // members are not set.
  Evaluation worst;
  int worst_run = 0;  // index: most losses, then the largest position error
};
TrackingSummary SummariseTracking(const std::vector<TrackingScore>& scores);

// Comparison of a value with its bounds.
struct TargetCheck {
  std::string name;  // "position", "worst position", ...
  double value = 0.0;
  double low = 0.0;  // met: low <= value <= high
  double high = 0.0;
  std::string unit;
  bool is_met() const { return value >= low && value <= high; }  // false for NaN
};
// Compares a summary with the targets. The worst run may have twice the errors and twice the time without a good pose.
std::vector<TargetCheck> CheckTargets(const TrackingSummary& summary, const TrackingTargets& targets);

}  // namespace evpose
