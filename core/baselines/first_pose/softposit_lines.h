// SPDX-License-Identifier: Apache-2.0

// First pose from lines without correspondences, with a prior: SoftPOSIT for lines.
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

// The defaults are validated by softposit_lines_test, which requires a number of right poses; `evpose bench
// initialization` runs with them (core/experiments/RESULTS.md, The first pose).
struct SoftPositOptions {
  // Maximum number of starts: the mean of the prior and draws from it, until one explains enough segments. The paper
  // reports tens of starts for objects of this size.
  int max_starts = 50;
  // Share of explained segments at which no further start is made.
  double good_ratio = 0.8;
  // Deterministic annealing: the inverse of the squared distance, 1/px^2, at which the weight of a match decreases. It
  // runs from 22 px to 2 px. 22 px is less than the error of the projection of the prior, but no more than the spacing
  // of the lines of a dense object: with 70 px the spacecraft was never right, with 14 px the boxes less often. The
  // factor per step is that of the paper.
  double initial_beta_per_px2 = 2e-3;
  double final_beta_per_px2 = 0.25;
  double beta_factor = 1.05;
  // Pixels: a match with a larger distance of its end points is worse than no match.
  double max_distance_px = 4.0;
  // Pixels: largest distance of an end point from a projected line when starts are scored.
  double threshold_px = 6.0;

  // INVALID_ARGUMENT names the field.
  absl::Status Validate() const;
};

// David, DeMenthon, Duraiswami, Samet, "Simultaneous pose and correspondence determination using line features", CVPR
// 2003, after their SoftPOSIT for points (IJCV 2004). During the annealing it alternates between soft assignments of
// segments to model lines (Sinkhorn normalisation, with a slack for those without a match) and POSIT: both ends of a
// model line should project to the feet of their perpendiculars on the line of the segment.
//
// Differences from the paper: the distance of a segment from a projected line is that of its ends from the nearest
// points of it, in pixels; the paper adds the weighted angle between them. Lines are ignored if all their faces are
// turned away; the paper leaves hidden lines to the slack. POSIT solves for four unknowns from the points of the model;
// points in one plane leave one of them undetermined, so that planar objects have no solution (Table I of LOPET, "-").
//
// Equal seeds give equal poses. Errors: INVALID_ARGUMENT for the options; NOT_FOUND if no start explains four segments,
// or the model is planar.
absl::StatusOr<RigidTransform> EstimatePoseBySoftPosit(const ObjectModel& model, const CameraModel& camera,
                                                       absl::Span<const ImageSegment> segments, const PosePrior& prior,
                                                       const SoftPositOptions& options, uint64_t seed);

}  // namespace evpose
