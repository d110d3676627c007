// SPDX-License-Identifier: Apache-2.0

// Score of a pose by the segments that it explains without known correspondences; the criterion of the baselines that
// search for correspondences.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/baselines/first_pose/line_match.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// Whether all faces of a line are turned away from a camera at this place in the object frame; false without faces.
bool IsTurnedAway(const ModelLine& line, const Eigen::Vector3d& camera_object);

// A pose that explains fewer segments is rejected: three always fit.
inline constexpr int kMinInliers = 4;

struct PoseScore {
  int inliers = 0;  // segments that lie on a projected line
  // Sum over the segments of the squared distances of their ends, pixels^2, each truncated at the threshold.
  double cost_px2 = 0.0;
  std::vector<int> model_line;  // for each segment, index into ObjectModel::lines, or -1

  bool IsBetterThan(const PoseScore& other) const {
    return inliers != other.inliers ? inliers > other.inliers : cost_px2 < other.cost_px2;
  }
};

// The best pose of a search so far.
struct BestPose {
  std::optional<RigidTransform> pose;
  PoseScore score;

  // Keeps the pose if it explains enough segments and is better; returns whether it is kept.
  bool Offer(const RigidTransform& camera_from_object, PoseScore score_of_pose);
};

// Scores poses. A segment is an inlier if both its ends are within `threshold_px` of the line through a projected edge
// and not farther than 10 px beyond the ends of the edge. Lines are ignored if all their faces are turned away;
// other occlusion is not considered. The model and the segments must outlive the scorer.
class PoseScorer {
 public:
  PoseScorer(const ObjectModel& model, const CameraModel& camera, absl::Span<const ImageSegment> segments,
             double threshold_px);

  const ObjectModel& model() const { return model_; }
  const CameraModel& camera() const { return camera_; }
  absl::Span<const ImageSegment> segments() const { return segments_; }

  // Scores a pose. No segment is an inlier if a part of the model lies behind the camera.
  PoseScore Score(const RigidTransform& camera_from_object) const;
  // The same without model_line. Stops with inliers = INT_MIN as soon as `needed` inliers cannot be reached.
  PoseScore QuickScore(const RigidTransform& camera_from_object, int needed) const;
  std::vector<LineMatch> Matches(const PoseScore& score) const;

 private:
  struct Projected {
    Eigen::Vector2d p1_px;
    Eigen::Vector2d along;  // unit vector
    double length_px = 0.0;
    int line = 0;
  };
  bool Project(const RigidTransform& pose, std::vector<Projected>& lines) const;
  PoseScore ScoreProjected(const std::vector<Projected>& lines, int needed, bool with_lines) const;

  const ObjectModel& model_;
  const CameraModel camera_;
  const absl::Span<const ImageSegment> segments_;
  const double threshold_px_;
};

}  // namespace evpose
