// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/tracking_score.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/base/status_macros.h"
#include "core/experiments/tracking/wrong_time.h"
#include "core/geometry/trajectory.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
// Event rate above which poses come at the full rate, hertz, and the share of missing poses that is tolerated.
constexpr double kBusyHz = 0.3e6;
constexpr double kFullRateHz = 1000.0;
constexpr double kRateTolerance = 0.02;
// Time that the first pose may take, which is ignored.
constexpr int64_t kStartUs = 50'000;
// Share of the length of the lines that is in the image of an object in view: with less, a pose is hardly determined.
constexpr double kInViewRatio = 0.25;

bool IsInView(const ObjectModel& model, const CameraModel& camera, const RigidTransform& camera_from_object) {
  // Samples of a line: the length inside the image is then known to a tenth of each line that crosses the border.
  constexpr int kSamples = 10;
  double inside_m = 0.0;
  double all_m = 0.0;
  for (const ModelLine& line : model.lines) {
    const double piece_m = (line.p2 - line.p1).norm() / kSamples;
    for (int i = 0; i < kSamples; ++i) {
      const Eigen::Vector3d point = camera_from_object * (line.p1 + (line.p2 - line.p1) * ((i + 0.5) / kSamples));
      all_m += piece_m;
      if (point.z() <= 0.0) continue;
      const Eigen::Vector2d pixel = camera.Distort(camera.Project(point));
      const bool is_inside =
          pixel.x() >= 0.0 && pixel.y() >= 0.0 && pixel.x() <= camera.width_px - 1 && pixel.y() <= camera.height_px - 1;
      if (is_inside) inside_m += piece_m;
    }
  }
  return inside_m >= kInViewRatio * all_m;
}

Trajectory PosesOf(const TrackingOutput& output) {
  Trajectory trajectory;
  trajectory.reserve(output.poses.size());
  for (const PoseEstimate& pose : output.poses) trajectory.push_back({pose.t_us, pose.camera_from_object});
  return trajectory;
}

// Returns the poses that TrajectoryErrors used, in its order.
void ScoreHealth(const TrackingOutput& output, int64_t end_us, int64_t max_gap_us, TrackingScore& score) {
  size_t next = 0;
  WrongTime wrong(max_gap_us);
  for (size_t i = 0; i < score.errors.size(); ++i) {
    const TrajectoryError& error = score.errors[i];
    while (output.poses[next].t_us != error.t_us) ++next;
    const PoseEstimate& pose = output.poses[next];
    const int64_t until_us = i + 1 < score.errors.size() ? score.errors[i + 1].t_us : end_us;
    const double span_s = 1e-6 * static_cast<double>(std::min(until_us - error.t_us, max_gap_us));
    const bool is_tracking = pose.state == TrackState::kTracking;
    wrong.Add(error.t_us, is_tracking && !error.is_good);
    if (!is_tracking && error.is_good) score.right_untracked_s += span_s;
    score.nees.push_back(NormalisedErrorSquared(error.true_pose, pose.camera_from_object, pose.covariance));
  }
  wrong.Finish(end_us);
  score.wrong_tracking_s = 1e-6 * static_cast<double>(wrong.total_us());
  score.longest_wrong_tracking_s = 1e-6 * static_cast<double>(wrong.longest_us());
}

double MeanOver(const std::vector<TrackingScore>& scores, const auto& value) {
  double sum = 0.0;
  for (const TrackingScore& score : scores) sum += value(score);
  return sum / static_cast<double>(scores.size());
}

// NaN (no pose) counts as the worst value.
double WorstOver(const std::vector<TrackingScore>& scores, const auto& value) {
  double worst = -std::numeric_limits<double>::infinity();
  for (const TrackingScore& score : scores) {
    const double v = value(score);
    if (std::isnan(v)) return v;
    worst = std::max(worst, v);
  }
  return worst;
}

int WorstRun(const std::vector<TrackingScore>& scores) {
  const auto is_better = [](const TrackingScore& a, const TrackingScore& b) {
    if (a.losses != b.losses) return a.losses < b.losses;
    const double a_error = a.evaluation.position_rmse_of_depth;
    const double b_error = b.evaluation.position_rmse_of_depth;
    if (std::isnan(b_error)) return !std::isnan(a_error);
    return a_error < b_error;
  };
  return static_cast<int>(std::max_element(scores.begin(), scores.end(), is_better) - scores.begin());
}

void SetErrors(const std::vector<TrackingScore>& scores, TrackingSummary& summary) {
  using E = Evaluation;
  for (double E::*member :
       {&E::position_rmse_m, &E::position_mean_m, &E::position_median_m, &E::position_std_m, &E::position_rmse_of_depth,
        &E::rotation_mean_rad, &E::rotation_median_rad, &E::rotation_p95_rad, &E::coverage_ratio, &E::pose_rate_hz}) {
    summary.overall.evaluation.*member =
        MeanOver(scores, [member](const TrackingScore& score) { return score.evaluation.*member; });
  }
  const auto worst = [&](double E::*member) {
    return WorstOver(scores, [member](const TrackingScore& score) { return score.evaluation.*member; });
  };
  summary.overall.evaluation.rotation_max_rad = worst(&E::rotation_max_rad);
  for (double E::*member : {&E::position_rmse_of_depth, &E::rotation_median_rad, &E::rotation_p95_rad}) {
    summary.worst.*member = worst(member);
  }
  summary.worst.coverage_ratio =
      -WorstOver(scores, [](const TrackingScore& score) { return -score.evaluation.coverage_ratio; });
}

}  // namespace

void EventRate::Add(absl::Span<const Event> events) {
  num_events_ += events.size();
  for (const Event& event : events) {
    const auto interval = static_cast<size_t>(std::max<int64_t>(0, event.t_us - t_begin_us_) / kIntervalUs);
    if (interval >= counts_.size()) counts_.resize(interval + 1, 0);
    ++counts_[interval];
  }
}

double EventRate::ShareAtFullPoseRate(const std::vector<PoseEstimate>& poses) const {
  std::vector<uint32_t> num_poses(counts_.size(), 0);
  for (const PoseEstimate& pose : poses) {
    const int64_t since_us = pose.t_us - t_begin_us_;
    if (since_us < 0) continue;
    const auto interval = static_cast<size_t>(since_us / kIntervalUs);
    if (interval < num_poses.size()) ++num_poses[interval];
  }
  constexpr double kIntervalS = 1e-6 * kIntervalUs;
  uint64_t busy = 0;
  uint64_t full = 0;
  for (size_t i = kStartUs / kIntervalUs; i + 1 < counts_.size(); ++i) {
    if (counts_[i] <= kBusyHz * kIntervalS) continue;
    ++busy;
    full += num_poses[i] >= (1.0 - kRateTolerance) * kFullRateHz * kIntervalS ? 1 : 0;
  }
  return busy == 0 ? kNan : static_cast<double>(full) / static_cast<double>(busy);
}

absl::StatusOr<TrackingScore> ScoreTracking(const SimulationOptions& run, const ObjectModel& model,
                                            const Trajectory& truth, const EventRate& rate,
                                            const TrackingOutput& output) {
  EvaluationOptions options;
  options.symmetries = model.symmetries;
  options.continuous_symmetry = model.continuous_symmetry;
  const Trajectory estimate = PosesOf(output);
  TrackingScore score;
  EVPOSE_ASSIGN_OR_RETURN(score.evaluation, Evaluate(truth, estimate, options));
  EVPOSE_ASSIGN_OR_RETURN(score.errors, TrajectoryErrors(truth, estimate, options));
  uint64_t in_view = 0;
  for (const int64_t t_us : score.evaluation.losses_at_us) {
    EVPOSE_ASSIGN_OR_RETURN(const RigidTransform pose, Interpolate(truth, t_us));
    in_view += IsInView(model, run.camera, pose) ? 1 : 0;
  }
  score.losses = std::max(in_view, output.losses);
  const auto good = std::find_if(score.errors.begin(), score.errors.end(),
                                 [](const TrajectoryError& error) { return error.is_good; });
  score.first_pose_ms = good == score.errors.end() ? kNan : 1e-3 * static_cast<double>(good->t_us - run.t_begin_us);
  score.full_rate_ratio = rate.ShareAtFullPoseRate(output.poses);
  ScoreHealth(output, truth.back().t_us, options.max_gap_us, score);
  score.compute_ratio = output.compute_s / (1e-6 * static_cast<double>(run.duration_us));
  return score;
}

TrackingSummary SummariseTracking(const std::vector<TrackingScore>& scores) {
  TrackingSummary summary;
  if (scores.empty()) return summary;
  summary.num_runs = static_cast<int>(scores.size());
  SetErrors(scores, summary);
  TrackingScore& overall = summary.overall;
  for (double TrackingScore::*member :
       {&TrackingScore::first_pose_ms, &TrackingScore::full_rate_ratio, &TrackingScore::compute_ratio}) {
    overall.*member = MeanOver(scores, [member](const TrackingScore& score) { return score.*member; });
  }
  summary.worst_run = WorstRun(scores);
  std::vector<double> nees;
  for (const TrackingScore& score : scores) {
    overall.losses += score.losses;
    overall.wrong_tracking_s += score.wrong_tracking_s;
    overall.longest_wrong_tracking_s = std::max(overall.longest_wrong_tracking_s, score.longest_wrong_tracking_s);
    overall.right_untracked_s += score.right_untracked_s;
    nees.insert(nees.end(), score.nees.begin(), score.nees.end());
  }
  summary.consistency = SummariseConsistency(std::move(nees));
  return summary;
}

std::vector<TargetCheck> CheckTargets(const TrackingSummary& summary, const TrackingTargets& targets) {
  constexpr double kWorstFactor = 2.0;  // the worst recording may have this many times the error of the target
  const double infinity = std::numeric_limits<double>::infinity();
  const double position = 100.0 * targets.position_rmse_of_depth;
  const double uncovered = 1.0 - targets.coverage_ratio;
  const TrackingScore& overall = summary.overall;
  const Evaluation &mean = overall.evaluation, &worst = summary.worst;
  std::vector<TargetCheck> checks = {
      {"losses", static_cast<double>(overall.losses), 0.0, static_cast<double>(targets.losses), ""},
      {"coverage", 100.0 * mean.coverage_ratio, 100.0 * targets.coverage_ratio, 100.0, "%"},
      {"position", 100.0 * mean.position_rmse_of_depth, 0.0, position, "% of depth"},
      {"rotation median", kDegreesPerRadian * mean.rotation_median_rad, 0.0, targets.rotation_median_deg, "deg"},
      {"rotation p95", kDegreesPerRadian * mean.rotation_p95_rad, 0.0, targets.rotation_p95_deg, "deg"},
      {"NEES median", summary.consistency.median, targets.nees_median_low, targets.nees_median_high, ""},
      {"inside 95 %", 100.0 * summary.consistency.inside_95_ratio, 100.0 * targets.inside_95_ratio_low,
       100.0 * targets.inside_95_ratio_high, "%"},
  };
  if (!std::isnan(overall.full_rate_ratio)) {
    checks.push_back({"1 kHz", 100.0 * overall.full_rate_ratio, 100.0, infinity, "%"});
  }
  if (summary.num_runs < 2) return checks;
  const TargetCheck of_worst_run[] = {
      {"worst coverage", 100.0 * worst.coverage_ratio, 100.0 * (1.0 - kWorstFactor * uncovered), 100.0, "%"},
      {"worst position", 100.0 * worst.position_rmse_of_depth, 0.0, kWorstFactor * position, "% of depth"},
      {"worst rotation median", kDegreesPerRadian * worst.rotation_median_rad, 0.0,
       kWorstFactor * targets.rotation_median_deg, "deg"},
      {"worst rotation p95", kDegreesPerRadian * worst.rotation_p95_rad, 0.0, kWorstFactor * targets.rotation_p95_deg,
       "deg"},
  };
  checks.insert(checks.end(), std::begin(of_worst_run), std::end(of_worst_run));
  return checks;
}

}  // namespace evpose
