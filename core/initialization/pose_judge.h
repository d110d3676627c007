// Whole segments against the projected model at a pose: which are whose, what that costs, and the pose that fits best.
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/image_line.h"
#include "core/initialization/pose_search.h"
#include "core/initialization/search_model.h"

namespace evpose {

// A visible part of a line, projected.
struct ImagePart {
  int line = 0;  // index into SearchModel::lines
  Eigen::Vector2d a, b;
};

class PoseJudge {
 public:
  // All must outlive it.
  PoseJudge(const SearchModel& model, const CameraModel& camera, absl::Span<const ImageLine> lines,
            const PoseSearchOptions& options)
      : model_(model), camera_(camera), lines_(lines), options_(options) {}

  // Parts that may be seen at the pose, from the table of views: fast, and a few too many.
  std::vector<ImagePart> LikelyParts(const RigidTransform& pose) const;
  // Parts that are seen, by ray casting.
  std::vector<ImagePart> VisibleParts(const RigidTransform& pose) const;

  // For each image line the index into SearchModel::lines of the best part, or -1. Standard deviations are `widening`
  // times those of the options.
  std::vector<int> Match(absl::Span<const ImagePart> parts, double widening) const;

  // Levenberg-Marquardt steps on the distances of matched segments' ends from their lines; false when the matched lines
  // do not determine the pose or the object leaves the space before the camera.
  bool Refine(absl::Span<const int> matches, int iterations, RigidTransform& pose) const;

  // Matches and refines with ever narrower tolerances, then with what is visible. Returns false when fewer than three
  // segments are the object's or it comes apart.
  bool Settle(RigidTransform& pose) const;
  // With what is visible; `model_line` has `num_segments` entries.
  PoseHypothesis Judge(const RigidTransform& pose, size_t num_segments) const;

 private:
  const SearchModel& model_;
  const CameraModel& camera_;
  const absl::Span<const ImageLine> lines_;
  const PoseSearchOptions& options_;
};

}  // namespace evpose
