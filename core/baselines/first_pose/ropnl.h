// SPDX-License-Identifier: Apache-2.0

// First pose from lines with known correspondences by branch and bound: RoPnL.
#pragma once

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/first_pose/line_match.h"
#include "core/baselines/first_pose/rotation_bnb.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// RoPnL (Liu, Chen, Knoll, "Globally optimal camera orientation estimation from line correspondences by BnB algorithm",
// IEEE Robotics and Automation Letters 2021): the rotation with the most matches with n_j . R v_j near 0, by branch and
// bound, then the translation by linear least squares over these matches. The count has plateaus, and a half turn of a
// box about one of its axes preserves all directions up to sign. Therefore each rotation that reaches the maximum
// (among those that the search returns, which are the least-squares ones of their inliers) is tried, and the one with
// the smallest residual is kept. Rotation and translation are not refined together.
//
// Errors: INVALID_ARGUMENT for fewer than three matches or invalid options; NOT_FOUND if the lines do not determine the
// pose.
absl::StatusOr<RigidTransform> EstimatePoseByRopnl(const CameraModel& camera, absl::Span<const LineMatch> matches,
                                                   const RotationBnbOptions& options);

}  // namespace evpose
