// SPDX-License-Identifier: Apache-2.0

// Separates the surface that a mesh approximates from its tessellation: creases, boundaries and smooth regions
// (core/mesh/README.md, sections 8 to 10).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/mesh/types/edge_curve.h"
#include "core/mesh/types/raw_mesh.h"
#include "core/mesh/types/smooth_surface.h"

namespace evpose {

// Width, relative to the diameter, up to which a gap between flush parts causes no events: 0.45 px for an object of 300
// px. A line that is narrower than half a pixel changes the light of a pixel by less than the threshold of a sensor.
constexpr double kJointGap = 1.5e-3;

struct CreaseOptions {
  // Least angle, degrees, by which the surface turns at a crease; default, reason and validation: ModelOptions, which
  // checks it.
  double crease_angle_deg = 30.0;
  // False: the facets are the surface. Every edge that turns by more is a crease, and there are no regions.
  bool is_smooth = true;
};

// An edge of the mesh at which the surface turns or ends.
struct MeshEdge {
  std::array<uint32_t, 2> ends;       // indices of points, ascending
  std::vector<uint32_t> triangles;    // the triangles that have it as a side
  EdgeKind kind = EdgeKind::kCrease;  // kCrease or kBoundary
  double turn_rad = 0.0;              // angle between the normals of the first two triangles; 0 for a boundary
};

struct SurfaceEdges {
  std::vector<MeshEdge> edges;
  // Edges at narrow gaps between flush parts, which are not among `edges` (core/mesh/README.md, section 9).
  size_t num_joint_edges = 0;
  bool are_joints_searched = true;  // false: there are too many edges
  // Regions of shape kFree and kPlane, or those of `mesh.exact_surface`. Empty if `options.is_smooth` is false.
  SmoothSurface surface;
  // Only if `options.is_smooth` is false: the edges between two facets that are no creases and at which the surface
  // turns outward, each as the numbers of its two sides (FacetGraph).
  std::vector<std::array<uint32_t, 2>> facet_edges;
};

// Vertices of the mesh must be shared. `diameter_m` is that of the model. Time: O(n log n), and at most 40 million
// steps from triangle to triangle; edges beyond them are decided by the angle of their two triangles.
SurfaceEdges FindSurface(const RawMesh& mesh, const CreaseOptions& options, double diameter_m);

}  // namespace evpose
