// SPDX-License-Identifier: Apache-2.0

// Baseline with known correspondences, of points.
#pragma once

#include <Eigen/Core>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// A point of the object and where it was seen, undistorted.
struct PointMatch {
  Eigen::Vector3d point;  // object frame, metres
  Eigen::Vector2d pixel;
};

// SQPnP (Terzakis and Lourakis, "A consistently fast and globally optimal solution to the perspective-n-point problem",
// ECCV 2020), as OpenCV has it: the successor of OPnP (Zheng et al., ICCV 2013), which the source paper compares with;
// like it globally optimal, and of points. It is thus told more than a method of lines: which end of a segment is
// which, and that the segment ends where the line does.
// Of several solutions the one with the smallest reprojection error that lies in front of the camera.
// Errors: INVALID_ARGUMENT for fewer than three points; NOT_FOUND when OpenCV finds no pose.
absl::StatusOr<RigidTransform> EstimatePoseBySqpnp(const CameraModel& camera, absl::Span<const PointMatch> matches);

}  // namespace evpose
