// SPDX-License-Identifier: Apache-2.0

// First pose from points with known correspondences: SQPnP.
#pragma once

#include <Eigen/Core>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// A point of the object and its undistorted image.
struct PointMatch {
  Eigen::Vector3d point;  // object frame, metres
  Eigen::Vector2d pixel;
};

// SQPnP (Terzakis and Lourakis, "A consistently fast and globally optimal solution to the perspective-n-point problem",
// ECCV 2020), in the implementation of OpenCV. It is the successor of OPnP (Zheng et al., ICCV 2013), with which the
// paper compares: like OPnP it is globally optimal and uses points. It has more information than a method for lines:
// which end of a segment is which, and that the segment ends where the line does. Among several solutions in front of
// the camera, the one with the smallest reprojection error is returned.
//
// Errors: INVALID_ARGUMENT for fewer than three points; NOT_FOUND if OpenCV finds no pose.
absl::StatusOr<RigidTransform> EstimatePoseBySqpnp(const CameraModel& camera, absl::Span<const PointMatch> matches);

}  // namespace evpose
