// SPDX-License-Identifier: Apache-2.0

// A detected segment as the pose search uses it.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"

namespace evpose {

struct SearchSegment {
  int index = 0;  // of the segment in the caller's list
  // In the image, undistorted pixels: middle, unit vectors along and across, half the length.
  Eigen::Vector2d middle_px, along, across;
  double half_px = 0.0;
  // In the camera frame: bearings of the end points (z = 1); the back-projected plane's unit normal q1 x q2 / |q1 x
  // q2|; and in the plane the unit vector to the segment's middle, and the one at right angles to it.
  Eigen::Vector3d q1, q2, normal, sight, sideways;
  // How well the plane is known: variances (rad^2) of its turn about `sight` (by the segment's length) and about
  // `sideways` (the segment's shift). The variance of normal . d for a unit vector d near the plane is
  // turn (d . sideways)^2 + shift (d . sight)^2.
  double turn_variance = 0.0;
  double shift_variance = 0.0;

  double Variance(const Eigen::Vector3d& d) const {
    const double a = d.dot(sideways), b = d.dot(sight);
    return turn_variance * a * a + shift_variance * b * b;
  }
};

// The `max_lines` longest, the longest first (of equals the first given). Segments without length or with a number
// that is not finite are left out. `sigma_px`: of each end point, across the segment.
std::vector<SearchSegment> MakeSearchSegments(const CameraModel& camera, absl::Span<const ImageSegment> segments,
                                              double sigma_px, int max_lines);

}  // namespace evpose
