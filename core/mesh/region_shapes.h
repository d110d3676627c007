// SPDX-License-Identifier: Apache-2.0

// Planes, cylinders, cones and spheres in place of the facets that approximate them (core/mesh/README.md, section 12).
#pragma once

#include <Eigen/Core>
#include <array>

#include "core/mesh/types/raw_mesh.h"
#include "core/mesh/types/smooth_surface.h"

namespace evpose {

// Fits a shape to each region of unknown shape (kFree). A region that consists of flat and of curved parts, such as two
// faces and the fillet between them, is cut: its flat parts become planes, each connected rest is fitted again. Regions
// whose shape is already known stay. Where a shape fits, the corner normals become its normals. The vertices of `mesh`
// are taken to be points of the surface; `diameter_m` is the diameter of the model.
void FitShapes(const RawMesh& mesh, double diameter_m, SmoothSurface& surface);

// The point of the shape nearest to a point. Points without a unique nearest one, such as those on the axis of a
// cylinder, stay, as all points do for a region of unknown shape.
Eigen::Vector3d ProjectToShape(const SurfaceRegion& region, const Eigen::Vector3d& point);

// The outward unit normal of the shape at the projection of a point. Zero where it is undefined: on the axis of a
// cylinder or cone, at the centre of a sphere, for a region of unknown shape.
Eigen::Vector3d NormalOfShape(const SurfaceRegion& region, const Eigen::Vector3d& point);

// The point of the curved patch that the corners of a triangle and their unit normals define, at barycentric
// coordinates. Exact up to second order in the size of the triangle.
Eigen::Vector3d SmoothPoint(const std::array<Eigen::Vector3d, 3>& corners,
                            const std::array<Eigen::Vector3d, 3>& normals, const Eigen::Vector3d& barycentric);

}  // namespace evpose
