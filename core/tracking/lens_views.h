// SPDX-License-Identifier: Apache-2.0

// Turned pinhole views of a fisheye lens (core/tracking/README.md, section 7).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "core/geometry/camera.h"

namespace evpose {

struct LensView {
  Eigen::Matrix3d view_from_camera;
  // A pinhole camera without distortion, at least as large as the sensor, with as many pixels per radian at its axis as
  // the lens has there, in x and y. Its image ends with that of the lens to the left, right, top and bottom.
  CameraModel camera;
  bool is_searched = true;  // an object without a pose is searched for in these views, which together cover the lens
};

// The views that cover what the lens shows: the first one along the optical axis, the others towards the borders that
// are far from it, in steps of at most 25 degrees. `camera` must be valid.
std::vector<LensView> MakeLensViews(const CameraModel& camera);

}  // namespace evpose
