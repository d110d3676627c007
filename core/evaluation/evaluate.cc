// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/evaluate.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/models/continuous_symmetry.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

absl::Status CheckTimesIncrease(const Trajectory& trajectory, absl::string_view name) {
  for (size_t i = 1; i < trajectory.size(); ++i) {
    if (trajectory[i].t_us <= trajectory[i - 1].t_us) {
      return absl::InvalidArgumentError(absl::StrCat("the ", name, "'s times do not increase at pose ", i + 1,
                                                     "; sort the poses by time and remove duplicates"));
    }
  }
  return absl::OkStatus();
}

absl::Status CheckTruth(const Trajectory& truth) {
  if (truth.size() < 2) {
    return absl::InvalidArgumentError(absl::StrCat("the truth has ", truth.size(), " poses; at least 2 are needed"));
  }
  for (const StampedPose& pose : truth) {
    if (!(pose.camera_from_object.translation_m.z() > 0.0)) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "the truth at %.6f s has the object's origin behind the camera; give camera_from_object poses",
          pose.t_us * 1e-6));
    }
  }
  return CheckTimesIncrease(truth, "truth");
}

std::string TimeSpan(const Trajectory& trajectory) {
  return absl::StrFormat("%.6f to %.6f s", trajectory.front().t_us * 1e-6, trajectory.back().t_us * 1e-6);
}

// Returns the truth or the pose of truth * symmetry that is nearest to the estimate by rotation and then, of equal
// rotations, by distance: README, equation (1). NearestEquivalent() of core/models compares rotations alone.
RigidTransform NearestByRotationThenDistance(const RigidTransform& truth, const std::vector<RigidTransform>& symmetries,
                                             const RigidTransform& estimate) {
  const auto errors_of = [&estimate](const RigidTransform& pose) {  // compared in this order
    return std::pair(RotationAngle(pose.rotation, estimate.rotation),
                     (pose.translation_m - estimate.translation_m).norm());
  };
  RigidTransform best = truth;
  auto best_errors = errors_of(best);
  for (const RigidTransform& symmetry : symmetries) {
    const RigidTransform candidate = truth * symmetry;
    const auto errors = errors_of(candidate);
    if (!(errors < best_errors)) continue;
    best = candidate;
    best_errors = errors;
  }
  return best;
}

// Returns the points of the object for the reprojection error: points of its edges, or of its surface if it has none.
std::vector<Eigen::Vector3d> ComparedPoints(const ObjectModel& model) {
  std::vector<Eigen::Vector3d> points;
  for (const ModelLine& line : model.lines) points.insert(points.end(), {line.p1, line.p2});
  for (const EdgeCurve& curve : model.curves) points.insert(points.end(), curve.points.begin(), curve.points.end());
  return points.empty() ? model.vertices : points;
}

double MeanReprojectionError(const std::vector<Eigen::Vector3d>& points, const CameraModel& camera,
                             const RigidTransform& truth, const RigidTransform& estimate) {
  const double diagonal_px = std::hypot(camera.width_px, camera.height_px);
  double sum_px = 0.0;
  int count = 0;
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d true_point = truth * point;
    const Eigen::Vector3d estimated_point = estimate * point;
    if (true_point.z() <= 0.0) continue;
    ++count;
    const double distance_px = estimated_point.z() <= 0.0
                                   ? diagonal_px
                                   : (camera.Project(true_point) - camera.Project(estimated_point)).norm();
    sum_px += std::min(distance_px, diagonal_px);
  }
  return count == 0 ? 0.0 : sum_px / count;
}

std::vector<double> Values(const std::vector<TrajectoryError>& errors, double TrajectoryError::*member) {
  std::vector<double> values;
  values.reserve(errors.size());
  for (const TrajectoryError& error : errors) values.push_back(error.*member);
  return values;
}

double RootMeanSquare(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value * value;
  return std::sqrt(sum / static_cast<double>(values.size()));
}

void SummarisePosition(const std::vector<TrajectoryError>& errors, Evaluation& result) {
  std::vector<double> distances = Values(errors, &TrajectoryError::position_m);
  result.position_rmse_m = RootMeanSquare(distances);
  result.position_mean_m = Mean(distances);
  std::vector<double> deviations = distances;
  for (double& deviation : deviations) deviation -= result.position_mean_m;
  result.position_std_m = RootMeanSquare(deviations);
  std::sort(distances.begin(), distances.end());
  result.position_median_m = InterpolatedQuantile(distances, 0.5);
  result.position_rmse_of_depth = RootMeanSquare(Values(errors, &TrajectoryError::position_of_depth));
}

void SummariseRotation(const std::vector<TrajectoryError>& errors, Evaluation& result) {
  std::vector<double> angles = Values(errors, &TrajectoryError::rotation_rad);
  result.rotation_mean_rad = Mean(angles);
  std::sort(angles.begin(), angles.end());
  result.rotation_median_rad = InterpolatedQuantile(angles, 0.5);
  result.rotation_p95_rad = InterpolatedQuantile(angles, 0.95);
  result.rotation_max_rad = angles.back();
}

// An estimate, as far as times are concerned.
struct TimedEstimate {
  enum class Kind { kGood, kBad, kAmbiguous };
  int64_t t_us = 0;
  Kind kind = Kind::kBad;
};

std::vector<TimedEstimate> MergeTimes(const std::vector<TrajectoryError>& errors,
                                      absl::Span<const int64_t> ambiguous_us, int64_t begin_us, int64_t end_us) {
  std::vector<TimedEstimate> times;
  for (const TrajectoryError& error : errors) {
    times.push_back({error.t_us, error.is_good ? TimedEstimate::Kind::kGood : TimedEstimate::Kind::kBad});
  }
  for (const int64_t t_us : ambiguous_us) {
    if (t_us >= begin_us && t_us <= end_us) times.push_back({t_us, TimedEstimate::Kind::kAmbiguous});
  }
  std::stable_sort(times.begin(), times.end(),
                   [](const TimedEstimate& a, const TimedEstimate& b) { return a.t_us < b.t_us; });
  return times;
}

void SummariseTime(const std::vector<TimedEstimate>& times, int64_t begin_us, int64_t end_us, int64_t max_gap_us,
                   Evaluation& result) {
  using Kind = TimedEstimate::Kind;
  int64_t covered_us = 0;
  int64_t ambiguous_us = 0;
  bool is_in_good_period = false;
  int64_t good_at_us = 0;  // the last good estimate
  for (size_t i = 0; i < times.size(); ++i) {
    const bool is_last = i + 1 == times.size();
    const int64_t duration_us = (is_last ? end_us : times[i + 1].t_us) - times[i].t_us;
    if (times[i].kind == Kind::kGood) {
      covered_us += std::min(duration_us, max_gap_us);
      good_at_us = times[i].t_us;
      is_in_good_period = true;
    }
    if (times[i].kind == Kind::kAmbiguous) ambiguous_us += std::min(duration_us, max_gap_us);
    const bool is_followed_by_bad = !is_last && times[i + 1].kind == Kind::kBad;
    if (!is_in_good_period || (duration_us <= max_gap_us && !is_followed_by_bad)) continue;
    result.losses_at_us.push_back(good_at_us);
    is_in_good_period = false;
  }
  result.losses = result.losses_at_us.size();
  const auto span_us = static_cast<double>(end_us - begin_us);
  result.coverage_ratio = static_cast<double>(covered_us) / span_us;
  result.ambiguous_ratio = static_cast<double>(ambiguous_us) / span_us;
}

absl::Status CheckTrajectories(const Trajectory& truth, const Trajectory& estimate, const EvaluationOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckTruth(truth));
  return CheckTimesIncrease(estimate, "estimate");
}

// Mean over the estimates within the truth's time span.
double MeanReprojectionError(const ObjectModel& model, const CameraModel& camera,
                             const std::vector<TrajectoryError>& errors) {
  const std::vector<Eigen::Vector3d> points = ComparedPoints(model);
  double sum_px = 0.0;
  for (const TrajectoryError& error : errors) {
    sum_px += MeanReprojectionError(points, camera, error.true_pose, error.estimated_pose);
  }
  return sum_px / static_cast<double>(errors.size());
}

}  // namespace

absl::Status EvaluationOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckPositive("good_position_ratio", good_position_ratio));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("good_rotation_rad", good_rotation_rad));
  return CheckPositive("max_gap_us", static_cast<double>(max_gap_us));
}

absl::StatusOr<std::vector<TrajectoryError>> TrajectoryErrors(const Trajectory& truth, const Trajectory& estimate,
                                                              const EvaluationOptions& options) {
  EVPOSE_RETURN_IF_ERROR(CheckTrajectories(truth, estimate, options));
  std::vector<TrajectoryError> errors;
  for (const StampedPose& pose : estimate) {
    if (pose.t_us < truth.front().t_us || pose.t_us > truth.back().t_us) continue;
    EVPOSE_ASSIGN_OR_RETURN(const RigidTransform true_pose, Interpolate(truth, pose.t_us));
    TrajectoryError error;
    error.t_us = pose.t_us;
    error.estimated_pose = pose.camera_from_object;
    const std::optional<ContinuousSymmetry>& continuous = options.continuous_symmetry;
    error.true_pose = continuous
                          ? NearestEquivalent(true_pose, *continuous, pose.camera_from_object)
                          : NearestByRotationThenDistance(true_pose, options.symmetries, pose.camera_from_object);
    const Eigen::Vector3d centre = continuous ? continuous->centre : Eigen::Vector3d(Eigen::Vector3d::Zero());
    error.position_m = (pose.camera_from_object * centre - error.true_pose * centre).norm();
    error.position_of_depth = error.position_m / true_pose.translation_m.z();
    error.rotation_rad = RotationAngle(error.true_pose.rotation, pose.camera_from_object.rotation);
    error.is_good =
        error.position_of_depth <= options.good_position_ratio && error.rotation_rad <= options.good_rotation_rad;
    errors.push_back(error);
  }
  return errors;
}

absl::StatusOr<Evaluation> Evaluate(const Trajectory& truth, const Trajectory& estimate,
                                    const EvaluationOptions& options, const ObjectModel* model,
                                    const CameraModel* camera, absl::Span<const int64_t> ambiguous_us) {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<TrajectoryError> errors, TrajectoryErrors(truth, estimate, options));
  Evaluation result;
  result.num_poses = errors.size();
  const int64_t begin_us = truth.front().t_us;
  const int64_t end_us = truth.back().t_us;
  SummariseTime(MergeTimes(errors, ambiguous_us, begin_us, end_us), begin_us, end_us, options.max_gap_us, result);
  if (errors.empty()) {
    if (!estimate.empty()) {
      return absl::InvalidArgumentError(absl::StrCat("the estimate (", TimeSpan(estimate),
                                                     ") lies outside the truth's time span (", TimeSpan(truth),
                                                     "); give both on the sensor's clock, in seconds"));
    }
    return result;
  }
  SummarisePosition(errors, result);
  SummariseRotation(errors, result);
  if (errors.size() > 1) {
    const double duration_s = static_cast<double>(errors.back().t_us - errors.front().t_us) * 1e-6;
    result.pose_rate_hz = static_cast<double>(errors.size() - 1) / duration_s;
  }
  if (model != nullptr && camera != nullptr) {
    result.reprojection_mean_px = MeanReprojectionError(*model, *camera, errors);
  }
  return result;
}

}  // namespace evpose
