// SPDX-License-Identifier: Apache-2.0

// Whole segments against the projected model at a pose: which are whose, what that costs, and the pose that fits best.
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/pose_search.h"
#include "core/initialization/search_model.h"
#include "core/initialization/search_segment.h"
#include "core/initialization/segment_fit.h"

namespace evpose {

// A visible part of a line.
struct ImagePart {
  int line = 0;                // index into SearchModel::lines
  Eigen::Vector3d a, b;        // object frame
  Eigen::Vector2d a_px, b_px;  // projected
};

class PoseJudge {
 public:
  // All must outlive it.
  PoseJudge(const SearchModel& model, const CameraModel& camera, absl::Span<const SearchSegment> lines,
            const PoseSearchOptions& options)
      : model_(model), camera_(camera), lines_(lines), options_(options) {}

  // Parts that may be seen at the pose, from the table of views: fast, and a few too many.
  std::vector<ImagePart> LikelyParts(const RigidTransform& pose) const;
  // Parts that are seen, by ray casting.
  std::vector<ImagePart> VisibleParts(const RigidTransform& pose) const;

  // The image lines that fit a part, each with the best.
  std::vector<SegmentMatch> Match(absl::Span<const ImagePart> parts, double widening) const;

  // Normal equations of the weighted squares, for the tangent of rigid_transform.h, and the cost.
  struct Normal {
    Matrix6d h = Matrix6d::Zero();
    Vector6d g = Vector6d::Zero();
    double cost = 0.0;
    void Add(const Vector6d& row, double residual, double weight) {
      const Vector6d weighted = weight * row;
      h.noalias() += weighted * row.transpose();
      g += weighted * residual;
      cost += weight * residual * residual;
    }
  };
  // Of the matches at a pose. False when a line reaches behind the camera.
  bool Accumulate(absl::Span<const SegmentMatch> matches, const FitWeights& weights, const RigidTransform& pose,
                  Normal& normal) const;

  // Levenberg-Marquardt steps on the cost of the matches; false when they do not determine the pose or the object
  // leaves the space before the camera.
  bool Refine(absl::Span<const SegmentMatch> matches, double widening, int iterations, RigidTransform& pose) const;

  // Matches and refines with ever narrower tolerances, with what may be seen. Returns false when fewer than three
  // segments are the object's or the pose is not determined.
  bool Settle(RigidTransform& pose) const;
  // What a pose costs when these parts are to be seen; `model_line` has `num_segments` entries.
  PoseHypothesis Judge(const RigidTransform& pose, absl::Span<const ImagePart> parts, size_t num_segments) const;
  // Refines with what is visible, by ray casting, and judges.
  PoseHypothesis Finish(RigidTransform pose, size_t num_segments) const;
  // The same, by Ceres to the minimum (RefineToMinimum): for the few poses that are worth it.
  PoseHypothesis Polish(RigidTransform pose, size_t num_segments) const;
  // The other pose of a flat object: the depths of the matched lines turned over about their middle, and refined. Under
  // weak perspective a plane's picture stays the same. False when the lines do not allow it.
  bool TurnOver(RigidTransform& pose) const;

 private:
  bool IsBeforeCamera(const RigidTransform& pose) const;
  // Where the parts appear when the object is at the pose.
  void Project(const RigidTransform& pose, std::vector<ImagePart>& parts) const;
  ImagePart MakePart(const RigidTransform& pose, int line, double begin, double end) const;

  const SearchModel& model_;
  const CameraModel& camera_;
  const absl::Span<const SearchSegment> lines_;
  const PoseSearchOptions& options_;
};

}  // namespace evpose
