// SPDX-License-Identifier: Apache-2.0

// Line segments in the image.
#pragma once

#include <Eigen/Core>

#include "core/geometry/camera.h"

namespace evpose {

// A segment by its end points in undistorted pixels.
struct ImageSegment {
  Eigen::Vector2d p1_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d p2_px = Eigen::Vector2d::Zero();

  double length_px() const { return (p2_px - p1_px).norm(); }
};

// Bearing (x, y, 1) of an undistorted pixel.
Eigen::Vector3d BearingOfPixel(const CameraModel& camera, const Eigen::Vector2d& pixel);

// Unit normal in the camera frame of the interpretation plane, the plane through the camera's centre and the segment:
// n = b1 x b2 / |b1 x b2| for the bearings of the end points (core/initialization/README.md). Zero for a segment of
// length 0.
Eigen::Vector3d BackProjectedNormal(const CameraModel& camera, const ImageSegment& segment);

}  // namespace evpose
