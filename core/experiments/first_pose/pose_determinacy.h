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

// Makes three tests of the visible parts of the lines at a true pose, as if every one of them had been detected:
//   - The Cramer-Rao bound of the distances of the end points from their lines (core/experiments/README.md, section 2)
//     is within the tolerances of a right pose (pose_comparison.h), for rotation and position each, in the worst
//     direction, at three standard deviations.
//   - The other pose of a flat scene (with inverted depths) is distinguished by its residuals, by three sigmas of the
//     likelihood ratio, or by the lines that would be visible.
//   - There is no rigid motion, other than the symmetries, under which other lines of the model have the same image.
//     The back of a book is an example: its top cannot be distinguished from its bottom.
class PoseDeterminacy {
 public:
  // The model, with its symmetries, and `visibility` must outlive this object. `camera` has no distortion. `noise_px`:
  // standard deviation of each coordinate of an end point of a segment.
  PoseDeterminacy(const ObjectModel& model, const CameraModel& camera, const VisibilityTester& visibility,
                  double noise_px);

  bool IsDetermined(const RigidTransform& camera_from_object, absl::Span<const VisibleSegment> visible) const;

 private:
  bool BoundAllowsErrors(const RigidTransform& pose, absl::Span<const VisibleSegment> visible) const;
  bool MirrorIsDistinguished(const RigidTransform& pose, absl::Span<const VisibleSegment> visible) const;
  bool NothingLooksTheSame(const RigidTransform& pose, absl::Span<const VisibleSegment> visible) const;
  bool IsEquivalent(const RigidTransform& pose, const RigidTransform& truth) const;
  bool LooksTheSame(const RigidTransform& pose, const RigidTransform& truth,
                    absl::Span<const VisibleSegment> visible) const;

  const ObjectModel& model_;
  const CameraModel camera_;
  const VisibilityTester& visibility_;
  const double noise_px_;
};

}  // namespace evpose
