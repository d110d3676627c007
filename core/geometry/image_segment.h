// SPDX-License-Identifier: Apache-2.0

// A straight piece of an image line.
#pragma once

#include <Eigen/Core>

#include "core/geometry/camera.h"

namespace evpose {

// End points in undistorted pixels.
struct ImageSegment {
  Eigen::Vector2d p1_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d p2_px = Eigen::Vector2d::Zero();

  double length_px() const { return (p2_px - p1_px).norm(); }
};

// Unit normal, camera frame, of the plane through the camera's centre and the segment: n = q1 x q2 / |q1 x q2|
// (core/initialization/README.md). Zero for a segment without length.
Eigen::Vector3d BackProjectedNormal(const CameraModel& camera, const ImageSegment& segment);

}  // namespace evpose
