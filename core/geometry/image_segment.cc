// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/image_segment.h"

#include <Eigen/Geometry>

namespace evpose {

Eigen::Vector3d BearingOfPixel(const CameraModel& camera, const Eigen::Vector2d& pixel) {
  return {(pixel.x() - camera.cx_px) / camera.fx_px, (pixel.y() - camera.cy_px) / camera.fy_px, 1.0};
}

Eigen::Vector3d BackProjectedNormal(const CameraModel& camera, const ImageSegment& segment) {
  const Eigen::Vector3d normal = BearingOfPixel(camera, segment.p1_px).cross(BearingOfPixel(camera, segment.p2_px));
  const double norm = normal.norm();
  return norm > 0.0 ? Eigen::Vector3d(normal / norm) : Eigen::Vector3d::Zero();
}

}  // namespace evpose
