// SPDX-License-Identifier: Apache-2.0

// How far rotations about an axis move a surface out of itself (core/models/README.md, section 4).
#pragma once

#include <Eigen/Core>
#include <array>

#include "core/models/object_model.h"

namespace evpose {

// Moments of a surface. Coordinates are relative to `centroid` and divided by `radius_m`.
struct SurfaceMoments {
  Eigen::Vector3d centroid = Eigen::Vector3d::Zero();  // centroid of the area, object frame, metres
  double radius_m = 0.0;                               // root mean square distance of the area from it; 0: no area
  Eigen::Matrix<double, 6, 6> slippage = Eigen::Matrix<double, 6, 6>::Zero();  // equation (4)
};
// Returns the moments with the normals of model.surface if there are any, else with those of the facets.
SurfaceMoments MomentsOf(const ObjectModel& model);

// An axis about which a rotation moves the surface least.
struct SlippageAxis {
  Eigen::Vector3d point;      // a point of the axis, in the coordinates of the moments
  Eigen::Vector3d direction;  // unit
  // Root mean square of the speed at which rotations move the surface out of itself, relative to the angular velocity
  // and `radius_m`, in increasing order: about `direction` and about the other two principal axes.
  std::array<double, 3> ratios;
};
// `preferred`: symmetric matrix whose quadratic form in the axis is added where rotations about several axes leave the
// surface in itself; zero: none.
SlippageAxis FindSlippageAxis(const SurfaceMoments& moments, const Eigen::Matrix3d& preferred);

// The matrix for `preferred` that measures how far rotations about axes through the centroid move lines and curves out
// of themselves.
Eigen::Matrix3d LineSlippage(const ObjectModel& model, const SurfaceMoments& moments);

}  // namespace evpose
