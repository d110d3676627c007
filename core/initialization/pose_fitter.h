// SPDX-License-Identifier: Apache-2.0

// Refines and scores poses against image segments (stages 4 to 7 of pose_search.h): associates the segments with the
// projected model, minimises the cost of the matches, and computes the final cost.
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

// The visible part of a line.
struct ImagePart {
  int line = 0;                // index into SearchModel::lines
  Eigen::Vector3d a, b;        // object frame
  Eigen::Vector2d a_px, b_px;  // projected
};

class PoseFitter {
 public:
  // All arguments must outlive the object.
  PoseFitter(const SearchModel& model, const CameraModel& camera, absl::Span<const SearchSegment> segments,
             const PoseSearchOptions& options)
      : model_(model), camera_(camera), segments_(segments), options_(options) {}

  // Returns a superset of the visible parts at the pose, from the table of views. Fast.
  std::vector<ImagePart> LikelyParts(const RigidTransform& pose) const;
  // Returns the visible parts, by ray casting.
  std::vector<ImagePart> VisibleParts(const RigidTransform& pose) const;

  // Associates each segment with the part of the lowest cost, if this is below unexplained_cost. `widening` multiplies
  // the standard deviations.
  std::vector<SegmentMatch> Match(absl::Span<const ImagePart> parts, double widening) const;

  // Normal equations of the weighted squares in the tangent space of rigid_transform.h, and the cost.
  struct NormalEquations {
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
  // Computes the normal equations of the matches at a pose. Returns false if a line extends behind the camera.
  bool Accumulate(absl::Span<const SegmentMatch> matches, const FitWeights& weights, const RigidTransform& pose,
                  NormalEquations& normal) const;

  // Minimises the cost of the matches by Levenberg-Marquardt steps. Returns false if they do not determine the pose or
  // if the object leaves the space in front of the camera.
  bool Refine(absl::Span<const SegmentMatch> matches, double widening, int iterations, RigidTransform& pose) const;

  // Stage 4: alternates matching, with gates that narrow, and refinement, on the superset of the visible parts. Returns
  // false if fewer than three segments are associated or if the pose is not determined.
  bool MatchAndRefine(RigidTransform& pose) const;
  // Computes the cost of a pose, given the visible parts; `model_line` has `num_segments` entries.
  PoseHypothesis Score(const RigidTransform& pose, absl::Span<const ImagePart> parts, size_t num_segments) const;
  // Stages 5 and 6: refines and scores the pose with the parts that ray casting finds visible.
  PoseHypothesis ScoreVisible(RigidTransform pose, size_t num_segments) const;
  // Stage 7: the same, but refines to the minimum of the cost, for the few poses that a search returns.
  PoseHypothesis ScoreMinimum(RigidTransform pose, size_t num_segments) const;
  // Stage 6: computes the second pose of a flat object by reflecting the depths of the matched lines about their mean
  // (README, equation (8)), and refines it. Under weak perspective both poses have the same image. Returns false if the
  // lines do not permit it.
  bool ReflectDepths(RigidTransform& pose) const;

 private:
  bool IsBeforeCamera(const RigidTransform& pose) const;
  // Projects the parts of the object at the pose.
  void Project(const RigidTransform& pose, std::vector<ImagePart>& parts) const;
  ImagePart MakePart(const RigidTransform& pose, int line, double begin, double end) const;

  const SearchModel& model_;
  const CameraModel& camera_;
  const absl::Span<const SearchSegment> segments_;
  const PoseSearchOptions& options_;
};

}  // namespace evpose
