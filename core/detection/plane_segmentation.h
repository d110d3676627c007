// SPDX-License-Identifier: Apache-2.0

// Segments the events into planes in space and time (core/detection/README.md, section 1; Liu et al., "Line-based 6-DoF
// Object Pose Estimation and Tracking With an Event Camera", IEEE TIP 2024, Sec. III-A): the events of a straight
// moving edge lie near a plane in (u, v, c t).
#pragma once

#include <vector>

#include "absl/status/status.h"
#include "core/detection/event_stretch.h"
#include "core/detection/moving_line.h"

namespace evpose {

struct PlaneSegmentationOptions {
  // Side of the cells of (u, v, c t), pixels. The mean of the events of a cell is one point, which halves the noise of
  // pixels and of the several events of an edge at a pixel, and bounds the number of points. All values of this struct
  // are validated by simulated_lines_test and driving_lines_test.
  double cell_px = 2.0;
  // Maximum number of points of one polarity; more are downsampled uniformly. It bounds the time and memory of the
  // segmentation; with fewer points a short edge has too few for a plane.
  int max_points = 5000;
  // Maximum distance of neighbours, pixels. The points of an edge are one or two cells apart.
  double neighbour_radius_px = 5.0;
  // Number of nearest neighbours from which the normal of a point is computed: with more of them the noise of a normal
  // is smaller, but neighbours from another edge are more frequent.
  int max_neighbours = 16;
  // A point with fewer neighbours is noise and is removed.
  int min_neighbours = 5;
  // Maximum angle between the normals in one plane, degrees: above their noise, below the angles between edges.
  double smoothness_deg = 18.0;
  // Maximum ratio of the smallest eigenvalue of the neighbours' covariance to the sum of all. A point with a larger
  // one, in a corner or among many edges, does not extend a region.
  double max_curvature = 0.06;
  // Minimum number of points of a plane; chance produces smaller ones.
  int min_plane_points = 10;
  // Maximum distance of the inliers of a plane, pixels: above the scatter of the cells' means about an edge. A larger
  // one would accept points of a parallel edge.
  double inlier_px = 1.0;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Returns the edges of the planes, which are the start of a fit, in descending order of the number of points; this
// number is stored as MovingLine::num_events. `options` must be valid. If PCL throws an exception, the list is empty.
std::vector<MovingLine> SegmentPlanes(const EventStretch& stretch, const PlaneSegmentationOptions& options);

}  // namespace evpose
