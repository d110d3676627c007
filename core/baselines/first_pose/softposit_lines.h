// SPDX-License-Identifier: Apache-2.0

// Baseline without correspondences, with a first guess: SoftPOSIT for lines.
#pragma once

#include <cstdint>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/first_pose/pose_prior.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

struct SoftPositOptions {
  // Starts: the prior's middle and draws from it, until one explains enough. The paper counts the starts it takes: tens
  // for objects of this size.
  int max_starts = 50;
  // Share of the segments that ends the starts.
  double good_ratio = 0.8;
  // Deterministic annealing: the inverse of the squared distance, in square pixels, at which a match's weight falls
  // off. From 22 px, less than the error of a prior's projection but no farther than a dense object's lines are apart
  // (with 70 px the spacecraft never came right, with 14 px the boxes less often), to 2 px; the paper's factor for each
  // step.
  double initial_beta_per_px2 = 2e-3;
  double final_beta_per_px2 = 0.25;
  double beta_factor = 1.05;
  // Pixels: a match farther apart than this, for each end point, is worse than none.
  double max_distance_px = 4.0;
  // Pixels: an end point this near to a projected line is on it, when starts are judged.
  double threshold_px = 6.0;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// David, DeMenthon, Duraiswami, Samet, "Simultaneous pose and correspondence determination using line features", CVPR
// 2003, after their SoftPOSIT for points (IJCV 2004). Alternates, while it anneals, between soft assignments of
// segments to model lines (Sinkhorn's normalisation, with a slack for those without a partner) and POSIT: both ends of
// a model line should project to the foot of their perpendiculars on the segment's line. Adapted here: the distance of
// a segment from a projected line is that of its ends from the nearest points of it, in pixels, where the paper adds
// the angle between them with a weight; lines whose faces are all turned away take no part, where the paper leaves
// hidden lines to the slack. POSIT solves for four unknowns from the model's points: a plane leaves one of them open,
// so that planar objects have no solution (LOPET's Table I, "-"). Errors: INVALID_ARGUMENT for options; NOT_FOUND when
// no start explains four segments, or the model is planar.
absl::StatusOr<RigidTransform> EstimatePoseBySoftPosit(const ObjectModel& model, const CameraModel& camera,
                                                       absl::Span<const ImageSegment> segments, const PosePrior& prior,
                                                       const SoftPositOptions& options, uint64_t seed);

}  // namespace evpose
