// SPDX-License-Identifier: Apache-2.0

// Baseline without correspondences: RANSAC with a minimal line solver.
#pragma once

#include <cstdint>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

struct RansacP3lOptions {
  // Draws of three segments and three model lines. One in 12^3 / 24 = 72 is right for a cube without spurious lines;
  // one in 12^3 / 4 = 432 for a cuboid; 0.99 confidence takes 4.6 times as many. A dense object needs more than anybody
  // has time for. 20000 take about 80 ms.
  int num_draws = 20'000;
  // Pixels: an end point this near to a projected line is on it. Five standard deviations of the usual noise of 0.8 px:
  // poses of three lines are off by several of them.
  double threshold_px = 4.0;
  // Gauss-Newton steps on the winner's inliers.
  int refinement_iterations = 10;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Fischler and Bolles, "Random sample consensus", CACM 1981, as LOPET compares with it (its Sec. IV-C): 2D and 3D lines
// drawn at random, a pose of each draw, the one with the most inliers. Three matches give the rotation (p3l.h: Dhome et
// al., PAMI 1989; Chen, PAMI 1991), then the translation linearly; LOPET's draws go to ASPnL instead, which for three
// lines solves the same equations. The winner is refined on its inliers, twice.
// Errors: INVALID_ARGUMENT for options, NOT_FOUND when no draw explains four segments.
absl::StatusOr<RigidTransform> EstimatePoseByRansac(const ObjectModel& model, const CameraModel& camera,
                                                    absl::Span<const ImageSegment> segments,
                                                    const RansacP3lOptions& options, uint64_t seed);

}  // namespace evpose
