// SPDX-License-Identifier: Apache-2.0

// Planes in space and time (core/detection/README.md, section 1; Liu et al., "Line-based 6-DoF Object Pose Estimation
// and Tracking With an Event Camera", IEEE TIP 2024, Sec. III-A): the events of a straight moving edge lie near a plane
// in (u, v, c t).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/status/status.h"
#include "core/detection/event_stretch.h"

namespace evpose {

struct PlaneSegmentationOptions {
  // Pixels: side of the cells of (u, v, c t) whose events make one point, their mean. Halves the noise of pixels and
  // of several events of one edge at a pixel, and bounds the number of points.
  double cell_px = 2.0;
  // Points of one polarity, at most; thinned evenly beyond.
  int max_points = 5000;
  // Pixels: points within it are neighbours. An edge's points lie one or two cells apart.
  double neighbour_radius_px = 5.0;
  // Nearest of them that the normal is taken from.
  int max_neighbours = 16;
  // A point with fewer is noise and removed.
  int min_neighbours = 5;
  // Normals of neighbours in one plane differ by less; above their own scatter, below the angles between edges.
  double smoothness_deg = 18.0;
  // Share of the smallest eigenvalue in the sum: a point in a corner or a clutter of edges starts or spreads no plane.
  double max_curvature = 0.06;
  // Points: smaller planes are not told from chance.
  int min_plane_points = 10;
  // Pixels: farthest inlier of the plane fit.
  double inlier_px = 1.0;

  // INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// A plane as what it says of an edge: normal . (u, v) = offset + speed * tau.
struct SpaceTimePlane {
  Eigen::Vector2d normal = Eigen::Vector2d::UnitX();  // unit, in the image
  double offset_px = 0.0;
  double speed_px_per_s = 0.0;
  // Extent of the inliers along (-normal.y, normal.x).
  double s_begin_px = 0.0;
  double s_end_px = 0.0;
  uint8_t polarity = 0;
  int num_points = 0;
};

// By falling number of points. `options` must be valid. An exception of PCL is no plane.
std::vector<SpaceTimePlane> SegmentPlanes(const EventStretch& stretch, const PlaneSegmentationOptions& options);

}  // namespace evpose
