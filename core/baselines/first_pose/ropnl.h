// SPDX-License-Identifier: Apache-2.0

// Baseline with known correspondences, of lines, by branch and bound.
#pragma once

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/first_pose/line_match.h"
#include "core/baselines/first_pose/rotation_bnb.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// RoPnL (Liu, Chen, Knoll, "Globally optimal camera orientation estimation from line correspondences by BnB algorithm",
// IEEE Robotics and Automation Letters 2021): the rotation with the most matches n_j . R v_j near 0, by branch and
// bound, then the translation by linear least squares over them. As the count has plateaus, and turning a box by half
// a turn about one of its axes leaves all its directions, each rotation that reaches the maximum (of those that the
// search returns, the least-squares ones of their inliers) is tried, and the one with the smallest residual kept.
// Nothing is refined together.
// Errors: INVALID_ARGUMENT for fewer than three matches or options; NOT_FOUND when the lines leave the pose open.
absl::StatusOr<RigidTransform> EstimatePoseByRopnl(const CameraModel& camera, absl::Span<const LineMatch> matches,
                                                   const RotationBnbOptions& options);

}  // namespace evpose
