// SPDX-License-Identifier: Apache-2.0

// Line segments in the image.
#pragma once

#include <Eigen/Geometry>

#include "core/geometry/camera.h"

namespace evpose {

// A segment by its end points in undistorted pixels.
struct ImageSegment {
  Eigen::Vector2d p1_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d p2_px = Eigen::Vector2d::Zero();

  double length_px() const { return (p2_px - p1_px).norm(); }
};

// Unit normal in the camera frame of the interpretation plane, the plane through the camera's centre and the segment:
// n = b1 x b2 / |b1 x b2| for the bearings of the end points (core/initialization/README.md). Zero for a segment of
// length 0.
inline Eigen::Vector3d BackProjectedNormal(const CameraModel& camera, const ImageSegment& segment) {
  const Eigen::Vector3d normal = BearingOf(camera, segment.p1_px).cross(BearingOf(camera, segment.p2_px));
  const double norm = normal.norm();
  return norm > 0.0 ? Eigen::Vector3d(normal / norm) : Eigen::Vector3d::Zero();
}

}  // namespace evpose
