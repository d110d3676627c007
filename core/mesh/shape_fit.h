// SPDX-License-Identifier: Apache-2.0

// Least-squares planes, cylinders, cones and spheres (core/mesh/README.md, section 12).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "absl/types/span.h"
#include "core/mesh/types/raw_mesh.h"
#include "core/mesh/types/smooth_surface.h"

namespace evpose {

enum class ShapeChoice : uint8_t { kAny, kCurved };

// A facet of the mesh: its centroid, unit normal (zero without area) and area.
struct FacetGeometry {
  Eigen::Vector3d centroid;
  Eigen::Vector3d normal;
  double area_m2;
};
FacetGeometry FacetOf(const RawMesh& mesh, uint32_t triangle);

// The normal of a shape at a corner of a facet. At the apex of a cone it is that of the generator through the middle of
// the facet.
Eigen::Vector3d CornerNormal(const SurfaceRegion& region, const Eigen::Vector3d& corner, const FacetGeometry& facet);

// The first of plane (unless `choice` is kCurved), cylinder, cone and sphere on which all vertices of the triangles lie
// and whose normals agree with those of the triangles. None: no value.
std::optional<SurfaceRegion> FitShape(const RawMesh& mesh, absl::Span<const uint32_t> triangles, ShapeChoice choice,
                                      double diameter_m);

}  // namespace evpose
