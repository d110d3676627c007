// SPDX-License-Identifier: Apache-2.0

// Turned pinhole views of a fisheye lens (core/tracking/README.md, section 7).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "core/geometry/camera.h"

namespace evpose {

struct LensView {
  Eigen::Matrix3d view_from_camera;
  // A pinhole camera without distortion, with the size of the sensor and about as many pixels per radian at its axis as
  // the lens has there. Its image does not exceed that of the lens to the left, right, top and bottom.
  CameraModel camera;
};

// The views that cover what the lens shows: the first one along the optical axis, the others towards the borders that
// are far from it, so that each direction is at most about 30 degrees from the axis of a view, horizontally and
// vertically. `camera` must be valid.
std::vector<LensView> MakeLensViews(const CameraModel& camera);

}  // namespace evpose
