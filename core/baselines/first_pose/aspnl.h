// SPDX-License-Identifier: Apache-2.0

// Baseline with known correspondences, of lines.
#pragma once

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/first_pose/line_match.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// ASPnL, the accurate subset-based solution (Xu, Zhang, Cheng, Koch, "Pose estimation from line correspondences: a
// complete analysis and a series of solutions", TPAMI 2017), derived anew from its outline:
// 1. The longest segment, and the next one of another direction, form a triple with each of the others. Each triple
//    gives the polynomial of p3l.h in one angle.
// 2. The sum of their squares (degree 16 in the tangent of half the angle) has several minima; all are candidates.
// 3. At each minimum the second angle is the least-squares one over all lines (a quartic), the translation linear.
// 4. The best of them are refined over all lines, and the one with the smallest residual is kept.
// Where it differs: lines weigh by their segments' lengths; the minima are found by sampling (aspnl.cc).
// Every match counts: there is no outlier rejection.
// Errors: INVALID_ARGUMENT for fewer than three matches; NOT_FOUND when the lines leave the pose open, all parallel or
// all through one image point.
absl::StatusOr<RigidTransform> EstimatePoseByAspnl(const CameraModel& camera, absl::Span<const LineMatch> matches);

}  // namespace evpose
