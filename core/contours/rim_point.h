// SPDX-License-Identifier: Apache-2.0

// Points of occluding contours: where the surface turns away from the eye (core/contours/README.md, section 2).
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "core/mesh/types/smooth_surface.h"

namespace evpose {

struct RimPoint {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();   // object frame, metres
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // outward, unit
  // Radius of curvature, metres, of the normal section along the ray; 0: the surface is concave along the ray there and
  // hides its own contour.
  double radius_m = 0.0;
  // Number of the facet edge that begins here, or else ends here, on a contour of facets (facet_contours.h).
  uint32_t facet_edge = 0;

  bool is_convex() const { return radius_m > 0.0; }
};

// Moves a point of the surface with its normal along the normal section of radius `radius_m` through the ray from
// `eye`, to where the normal is perpendicular to the ray (core/contours/README.md, equation (6)). False, without a
// change, if there is no such place within 60 degrees, as for an eye inside the circle.
bool MoveToRim(const Eigen::Vector3d& eye, double radius_m, Eigen::Vector3d& point, Eigen::Vector3d& normal);

// The contour point of a convex cylinder, cone or sphere that is nearest to a point of the surface, with the exact
// normal and radius (at most `max_radius_m`). The radius is 0 if the eye sees no contour.
RimPoint RimOfShape(const SurfaceRegion& region, const Eigen::Vector3d& eye, const Eigen::Vector3d& surface_point,
                    const Eigen::Vector3d& normal, double max_radius_m);

}  // namespace evpose
