// SPDX-License-Identifier: Apache-2.0

// The part of a straight line in space that a camera can see (core/models/README.md, section 3).
#pragma once

#include <Eigen/Core>

#include "core/geometry/camera.h"

namespace evpose {

// Lines are cut at this depth, because the projection divides by the depth.
inline constexpr double kClipDepthM = 1e-3;

// The points P1 + s (P2 - P1), begin <= s <= end.
struct LineInterval {
  double begin = 0.0;
  double end = 1.0;
  bool empty() const { return !(begin < end); }
};

// The part of the line, given in the camera frame, that projects into the image. For a camera with distortion the image
// is enlarged by the margin from which the distortion may move a point into it; points must then be tested with
// CameraModel::IsInImage().
LineInterval ClipToImage(const CameraModel& camera, const Eigen::Vector3d& p1, const Eigen::Vector3d& p2);

}  // namespace evpose
