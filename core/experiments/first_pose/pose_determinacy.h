// SPDX-License-Identifier: Apache-2.0

// Whether what is seen of an object tells its pose at all. Judged from the truth alone, without any estimator.
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"

namespace evpose {

struct DeterminacyOptions {
  double noise_px = 0.8;                 // standard deviation of each coordinate of a segment's end point
  double max_rotation_rad = 0.03490659;  // 2 deg: what counts as right
  double max_translation_ratio = 0.02;   // of the depth
  double num_sigmas = 3.0;               // the errors allowed must be this many standard deviations
};

// Three questions about the visible parts of lines at a true pose, as if every one of them had been found:
// - Does the Cramer-Rao bound of the distances of the segments' end points from their lines
// (core/experiments/README.md, section 2) allow the
//   errors, in rotation and position each, in the worst direction?
// - Is the other pose of a flat scene (its depths turned over) told apart by the residuals, by `num_sigmas` of the
//   likelihood ratio, or by the lines that it would show?
// - Is there no rigid motion under which other lines of the model, the symmetries apart, look the same? A book seen
//   from its back is one: nothing tells its top from its bottom.
class PoseDeterminacy {
 public:
  // The model must outlive it, with its symmetries. `camera` has no distortion.
  PoseDeterminacy(const ObjectModel& model, const CameraModel& camera, const VisibilityTester& visibility,
                  const DeterminacyOptions& options);

  bool IsDetermined(const RigidTransform& camera_from_object, absl::Span<const VisibleSegment> visible) const;

 private:
  bool BoundAllowsErrors(const RigidTransform& pose, absl::Span<const VisibleSegment> visible) const;
  bool MirrorIsTold(const RigidTransform& pose, absl::Span<const VisibleSegment> visible) const;
  bool NothingLooksTheSame(const RigidTransform& pose, absl::Span<const VisibleSegment> visible) const;
  bool IsEquivalent(const RigidTransform& pose, const RigidTransform& truth) const;
  bool LooksTheSame(const RigidTransform& pose, const RigidTransform& truth,
                    absl::Span<const VisibleSegment> visible) const;

  const ObjectModel& model_;
  const CameraModel camera_;
  const VisibilityTester& visibility_;
  const DeterminacyOptions options_;
};

}  // namespace evpose
