// SPDX-License-Identifier: Apache-2.0

// First pose from lines without correspondences: RANSAC with a minimal line solver.
#pragma once

#include <cstdint>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// The defaults are validated by ransac_p3l_test, which requires a number of right poses; `evpose bench initialization`
// runs with them (core/experiments/RESULTS.md, The first pose).
struct RansacP3lOptions {
  // Draws of three segments and three model lines. One in 12^3 / 24 = 72 is right for a cube without spurious lines,
  // and one in 12^3 / 4 = 432 for a cuboid; a confidence of 0.99 requires 4.6 times as many. Objects with many lines
  // would need more than is practical. 20000 draws take about 80 ms.
  int num_draws = 20'000;
  // Pixels: largest distance of an end point from a projected line: five standard deviations of the usual noise of 0.8
  // px, because poses from three lines deviate by several of them.
  double threshold_px = 4.0;
  // Gauss-Newton steps on the inliers of the best pose.
  int refinement_iterations = 10;

  // INVALID_ARGUMENT names the field.
  absl::Status Validate() const;
};

// Fischler and Bolles, "Random sample consensus", CACM 1981, as the paper uses it for comparison (LOPET, Sec. IV-C):
// image lines and model lines are drawn at random, each draw gives poses, and the pose with the most inliers wins.
// Three matches determine the rotation (p3l.h: Dhome et al., PAMI 1989; Chen, PAMI 1991), then the translation
// linearly. LOPET uses ASPnL instead, which solves the same equations for three lines. The best pose is refined on its
// inliers, twice.
//
// Equal seeds give equal poses. Errors: INVALID_ARGUMENT for the options; NOT_FOUND if no draw explains four segments.
absl::StatusOr<RigidTransform> EstimatePoseByRansac(const ObjectModel& model, const CameraModel& camera,
                                                    absl::Span<const ImageSegment> segments,
                                                    const RansacP3lOptions& options, uint64_t seed);

}  // namespace evpose
