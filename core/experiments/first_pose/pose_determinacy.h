// SPDX-License-Identifier: Apache-2.0

// Tests whether the visible parts of an object determine its pose, from the truth alone and without an estimator.
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"

namespace evpose {

struct DeterminacyOptions {
  double noise_px = 0.8;                 // pixels, standard deviation of each coordinate of an end point of a segment
  double max_rotation_rad = 0.03490659;  // 2 deg: tolerance of a right pose
  double max_translation_ratio = 0.02;   // relative to the depth; tolerance of a right pose
  double num_sigmas = 3.0;               // the tolerances must be at least this many standard deviations
};

// Makes three tests of the visible parts of the lines at a true pose, as if every one of them had been detected:
//   - The Cramer-Rao bound of the distances of the end points from their lines (core/experiments/README.md, section 2)
//     is within the tolerances, for rotation and position each, in the worst direction.
//   - The other pose of a flat scene (with inverted depths) is distinguished by its residuals, by `num_sigmas` of the
//     likelihood ratio, or by the lines that would be visible.
//   - There is no rigid motion, other than the symmetries, under which other lines of the model have the same image.
//   The
//     back of a book is an example: its top cannot be distinguished from its bottom.
class PoseDeterminacy {
 public:
  // The model, with its symmetries, and `visibility` must outlive this object. `camera` has no distortion.
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
