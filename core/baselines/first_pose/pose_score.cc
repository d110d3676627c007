// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/pose_score.h"

#include <algorithm>
#include <climits>
#include <utility>

namespace evpose {
namespace {

// Minimum depth of all line ends, relative to the diameter of the object: a pose with a nearer end is rejected.
constexpr double kMinDepthOfDiameter = 0.1;
// Pixels by which a segment may extend beyond an edge: the noise of its ends, and the errors of the pose.
constexpr double kAlongPx = 10.0;

}  // namespace

bool IsTurnedAway(const ModelLine& line, const Eigen::Vector3d& camera_object) {
  if (line.face_normals.empty()) return false;
  return std::all_of(line.face_normals.begin(), line.face_normals.end(),
                     [&](const Eigen::Vector3d& normal) { return normal.dot(camera_object - line.p1) <= 0.0; });
}

bool BestPose::Offer(const RigidTransform& camera_from_object, PoseScore score_of_pose) {
  if (score_of_pose.inliers < kMinInliers || !score_of_pose.IsBetterThan(score)) return false;
  pose = camera_from_object;
  score = std::move(score_of_pose);
  return true;
}

PoseScorer::PoseScorer(const ObjectModel& model, const CameraModel& camera, absl::Span<const ImageSegment> segments,
                       double threshold_px)
    : model_(model), camera_(camera), segments_(segments), threshold_px_(threshold_px) {}

bool PoseScorer::Project(const RigidTransform& pose, std::vector<Projected>& lines) const {
  constexpr double kMinLengthPx = 2.0;  // pixels; shorter lines have no direction
  const Eigen::Vector3d camera_object = pose.Inverse().translation_m;
  const double min_depth_m = kMinDepthOfDiameter * model_.diameter_m;
  for (size_t k = 0; k < model_.lines.size(); ++k) {
    const Eigen::Vector3d p1 = pose * model_.lines[k].p1;
    const Eigen::Vector3d p2 = pose * model_.lines[k].p2;
    if (!(p1.z() > min_depth_m && p2.z() > min_depth_m)) return false;
    if (IsTurnedAway(model_.lines[k], camera_object)) continue;
    const Eigen::Vector2d q1 = camera_.Project(p1);
    const Eigen::Vector2d way = camera_.Project(p2) - q1;
    const double length = way.norm();
    if (length < kMinLengthPx) continue;
    lines.push_back({q1, way / length, length, static_cast<int>(k)});
  }
  return true;
}

PoseScore PoseScorer::ScoreProjected(const std::vector<Projected>& lines, int needed, bool with_lines) const {
  const double worst_px2 = 2.0 * threshold_px_ * threshold_px_;
  PoseScore score;
  if (with_lines) score.model_line.assign(segments_.size(), -1);
  int left = static_cast<int>(segments_.size());
  for (size_t j = 0; j < segments_.size(); ++j, --left) {
    if (score.inliers + left < needed) return {INT_MIN, 0.0, {}};
    double best_px2 = worst_px2;
    for (const Projected& line : lines) {
      const Eigen::Vector2d a = segments_[j].p1_px - line.p1_px;
      const Eigen::Vector2d b = segments_[j].p2_px - line.p1_px;
      const double da = line.along.x() * a.y() - line.along.y() * a.x();
      if (da > threshold_px_ || da < -threshold_px_) continue;
      const double db = line.along.x() * b.y() - line.along.y() * b.x();
      if (db > threshold_px_ || db < -threshold_px_) continue;
      const double ta = line.along.dot(a), tb = line.along.dot(b);
      if (std::min(ta, tb) < -kAlongPx || std::max(ta, tb) > line.length_px + kAlongPx) continue;
      if (da * da + db * db >= best_px2) continue;
      best_px2 = da * da + db * db;
      if (with_lines) score.model_line[j] = line.line;
    }
    score.inliers += best_px2 < worst_px2;
    score.cost_px2 += best_px2;
  }
  return score;
}

PoseScore PoseScorer::Score(const RigidTransform& camera_from_object) const {
  std::vector<Projected> lines;
  lines.reserve(model_.lines.size());
  if (!Project(camera_from_object, lines)) lines.clear();
  return ScoreProjected(lines, 0, /*with_lines=*/true);
}

PoseScore PoseScorer::QuickScore(const RigidTransform& camera_from_object, int needed) const {
  std::vector<Projected> lines;
  lines.reserve(model_.lines.size());
  if (!Project(camera_from_object, lines)) return {INT_MIN, 0.0, {}};
  return ScoreProjected(lines, needed, /*with_lines=*/false);
}

std::vector<LineMatch> PoseScorer::Matches(const PoseScore& score) const {
  std::vector<LineMatch> matches;
  for (size_t j = 0; j < score.model_line.size(); ++j) {
    if (score.model_line[j] < 0) continue;
    const ModelLine& line = model_.lines[score.model_line[j]];
    matches.push_back({line.p1, line.p2, segments_[j]});
  }
  return matches;
}

}  // namespace evpose
