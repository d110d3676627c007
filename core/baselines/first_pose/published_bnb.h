// SPDX-License-Identifier: Apache-2.0

// Baseline without correspondences: the source paper's own initialisation.
#pragma once

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/first_pose/rotation_bnb.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

struct PublishedBnbOptions {
  RotationBnbOptions rotation;
  // Pixels: an end point this near to a projected line is on it. The rotation may be off by the inlier band of 1.7 deg,
  // which is 4 px at the end of an object of 250 px.
  double threshold_px = 6.0;
  // Triples of segments from which translations are computed, at most. Each takes all assignments of model lines with
  // the right directions: 64 for a box, some thousands for a spacecraft.
  int max_triples = 20;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// LOPET (Liu, Guan, Shang, Yu, Kneip, IEEE TIP 2024), Sec. III-B: the rotation that makes the most image lines
// perpendicular to a model direction, by branch and bound; then the translation linearly from n_j . (R P_k + T) = 0.
// The paper takes the correspondences for known after the rotation. They are not: parallel lines share a direction, and
// the count cannot tell the rotations that map the directions onto themselves. Here each rotation that reaches the
// maximum (of those that the search returns) is tried with each of those, the translations of triples of segments with
// every assignment of lines of their directions are enumerated, the one with the most segments on projected lines is
// kept, and solved again with all of them. The rotation stays what the count made it, the least-squares one of its
// inliers; nothing is refined together. More than the paper says, so that its objective is what is judged.
// The search uses the bounds of rotation_bnb.h: the published ones find the same maximum in more time.
// Errors: INVALID_ARGUMENT for options or a model without two directions; NOT_FOUND when no translation explains four
// segments.
absl::StatusOr<RigidTransform> EstimatePoseByPublishedBnb(const ObjectModel& model, const CameraModel& camera,
                                                          absl::Span<const ImageSegment> segments,
                                                          const PublishedBnbOptions& options);

}  // namespace evpose
