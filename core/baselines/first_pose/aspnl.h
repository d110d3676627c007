// SPDX-License-Identifier: Apache-2.0

// First pose from lines with known correspondences: ASPnL.
#pragma once

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/first_pose/line_match.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// ASPnL, the accurate subset-based solution (Xu, Zhang, Cheng, Koch, "Pose estimation from line correspondences: a
// complete analysis and a series of solutions", TPAMI 2017), implemented from its outline:
//   1. The longest segment, and the next one of another direction, form a triple with each of the others. Each triple
//      gives the polynomial of p3l.h in one angle.
//   2. The sum of the squared polynomials (degree 16 in the tangent of half the angle) has several minima; all are
//      candidates.
//   3. At each minimum the second angle is the least-squares one over all lines (a quartic); the translation is linear.
//   4. The best candidates are refined over all lines, and the one with the smallest residual is kept.
// Differences from the paper: lines are weighted by the length of their segments, and the minima are found by sampling
// (aspnl.cc). All matches are used; there is no outlier rejection.
//
// Errors: INVALID_ARGUMENT for fewer than three matches; NOT_FOUND if the lines do not determine the pose, because all
// are parallel or pass through one image point.
absl::StatusOr<RigidTransform> EstimatePoseByAspnl(const CameraModel& camera, absl::Span<const LineMatch> matches);

}  // namespace evpose
