// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/real_score.h"

#include <algorithm>
#include <cmath>

#include "core/evaluation/evaluate.h"
#include "core/experiments/tracking/wrong_time.h"
#include "core/models/continuous_symmetry.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Number of points of a model without lines at which the error is measured: more do not change its mean.
constexpr size_t kMaxPoints = 512;

// Largest distance in the image between the first pose of the reference in the time span and the others.
double MotionPx(const Trajectory& reference, int64_t begin_us, int64_t end_us, const ReprojectionError& error) {
  const RigidTransform* first = nullptr;
  double motion_px = 0.0;
  for (const StampedPose& pose : reference) {
    if (pose.t_us < begin_us || pose.t_us > end_us) continue;
    if (first == nullptr) first = &pose.camera_from_object;
    motion_px = std::max(motion_px, error.Px(*first, pose.camera_from_object).value_or(0.0));
  }
  return motion_px;
}

}  // namespace

ReprojectionError::ReprojectionError(const ObjectModel& model, const CameraModel& camera)
    : model_(model), camera_(camera) {
  for (const ModelLine& line : model.lines) points_.insert(points_.end(), {line.p1, line.p2});
  if (!points_.empty()) return;
  const size_t stride = 1 + model.vertices.size() / kMaxPoints;
  for (size_t i = 0; i < model.vertices.size(); i += stride) points_.push_back(model.vertices[i]);
}

std::optional<double> ReprojectionError::Px(const RigidTransform& reference, const RigidTransform& estimate) const {
  const RigidTransform nearest = NearestEquivalent(estimate, model_, reference);
  const double diagonal_px = std::hypot(camera_.width_px, camera_.height_px);
  double sum = 0.0;
  int count = 0;
  for (const Eigen::Vector3d& point : points_) {
    const Eigen::Vector3d expected = reference * point, found = nearest * point;
    if (!(expected.z() > 0.0)) continue;
    const Eigen::Vector2d pixel = camera_.Project(expected);
    if (!camera_.IsInImage(pixel)) continue;
    const double px = found.z() > 0.0 ? (camera_.Project(found) - pixel).norm() : diagonal_px;
    sum += std::min(px, diagonal_px) * std::min(px, diagonal_px);
    ++count;
  }
  if (count == 0) return std::nullopt;
  return std::sqrt(sum / count);
}

void ScoreRealPoses(absl::Span<const PoseEstimate> poses, const Trajectory* reference, const ReprojectionError* error,
                    double bound_px, RealRun& run) {
  const int64_t max_gap_us = EvaluationOptions().max_gap_us;
  const int64_t end_us = run.start_us + std::llround(1e6 * run.duration_s);
  double right_s = 0.0, doubtful_s = 0.0, ambiguous_s = 0.0;
  WrongTime wrong;
  std::vector<double> errors_px;
  for (size_t i = 0; i < poses.size(); ++i) {
    const PoseEstimate& pose = poses[i];
    const int64_t next_us = i + 1 < poses.size() ? poses[i + 1].t_us : end_us;
    const double span_s = 1e-6 * static_cast<double>(std::clamp<int64_t>(next_us - pose.t_us, 0, max_gap_us));
    const bool is_tracking = pose.state == TrackState::kTracking;
    double error_px = std::numeric_limits<double>::infinity();
    if (reference != nullptr) {
      const auto expected = Interpolate(*reference, pose.t_us);
      const auto measured = expected.ok() ? error->Px(*expected, pose.camera_from_object) : std::nullopt;
      if (!measured) continue;
      error_px = *measured;
      errors_px.push_back(error_px);
      if (is_tracking && std::isnan(run.first_error_px)) {
        run.first_error_px = error_px;
        run.is_first_wrong = error_px > bound_px;
      }
    }
    const bool is_right = error_px <= bound_px;
    right_s += is_right ? span_s : 0.0;
    (is_tracking ? run.tracking_s : doubtful_s) += span_s;
    ambiguous_s += pose.state == TrackState::kAmbiguous ? span_s : 0.0;
    wrong.Add(pose.t_us, is_tracking && !is_right);
  }
  wrong.Finish(end_us);
  run.wrong_s = 1e-6 * static_cast<double>(wrong.total_us());
  run.longest_wrong_s = 1e-6 * static_cast<double>(wrong.longest_us());
  run.right_ratio = run.duration_s > 0.0 ? right_s / run.duration_s : 0.0;
  run.doubtful_ratio = run.duration_s > 0.0 ? doubtful_s / run.duration_s : 0.0;
  run.ambiguous_ratio = run.duration_s > 0.0 ? ambiguous_s / run.duration_s : 0.0;
  if (reference != nullptr) run.motion_px = MotionPx(*reference, run.start_us, end_us, *error);
  if (errors_px.empty()) return;
  std::sort(errors_px.begin(), errors_px.end());
  run.median_error_px = InterpolatedQuantile(errors_px, 0.5);
  run.p95_error_px = InterpolatedQuantile(errors_px, 0.95);
}

}  // namespace evpose
