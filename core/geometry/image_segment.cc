// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/image_segment.h"

#include <Eigen/Geometry>

namespace evpose {

Eigen::Vector3d BackProjectedNormal(const CameraModel& camera, const ImageSegment& segment) {
  const Eigen::Vector3d normal = BearingOf(camera, segment.p1_px).cross(BearingOf(camera, segment.p2_px));
  const double norm = normal.norm();
  return norm > 0.0 ? Eigen::Vector3d(normal / norm) : Eigen::Vector3d::Zero();
}

}  // namespace evpose
