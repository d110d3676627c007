// SPDX-License-Identifier: Apache-2.0

// A detected segment in the form that the pose search uses.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"

namespace evpose {

struct SearchSegment {
  int index = 0;  // index in the caller's list
  // The middle in the image (undistorted pixels), the unit vectors along and across, and half the length.
  Eigen::Vector2d middle_px, along, across;
  double half_px = 0.0;
  // Vectors in the camera frame: the bearings q1, q2 of the end points (z = 1), and the unit normal q1 x q2 / |q1 x q2|
  // of the back-projected plane. `sight` is the unit vector in the plane to the segment's middle, `sideways` the unit
  // vector in the plane orthogonal to it.
  Eigen::Vector3d q1, q2, normal, sight, sideways;
  // Uncertainty of the plane: variances (rad^2) of its rotation about `sight` (from the segment's length) and about
  // `sideways` (from the segment's shift). For a unit vector d close to the plane, the variance of normal . d is turn
  // (d . sideways)^2 + shift (d . sight)^2.
  double turn_variance = 0.0;
  double shift_variance = 0.0;

  double Variance(const Eigen::Vector3d& d) const {
    const double a = d.dot(sideways), b = d.dot(sight);
    return turn_variance * a * a + shift_variance * b * b;
  }
};

// Returns the `max_segments` longest segments, the longest first; ties keep their order. Segments shorter than 4
// `sigma_px` or with a number that is not finite are skipped. `sigma_px` is the standard deviation of each end point
// across the segment.
std::vector<SearchSegment> MakeSearchSegments(const CameraModel& camera, absl::Span<const ImageSegment> segments,
                                              double sigma_px, int max_segments);

}  // namespace evpose
