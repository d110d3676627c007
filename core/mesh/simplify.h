// SPDX-License-Identifier: Apache-2.0

// Fewer triangles for a dense mesh (core/mesh/README.md, section 15).
#pragma once

#include <cstddef>

#include "core/mesh/types/raw_mesh.h"
#include "core/mesh/types/smooth_surface.h"

namespace evpose {

struct Simplification {
  size_t triangles_before = 0;
  size_t triangles_after = 0;
  double error_m = 0.0;  // largest distance of sampled vertices that were removed from the new surface
};

// Removes vertices inside the regions of `surface`, which are the regions of `mesh`, until about `max_triangles` are
// left or no vertex can be removed within `max_error_m`, which is positive. The edges between regions, the boundaries
// and the creases that end inside a region stay in place, and so do the points of the mesh, of which some are then
// unused. `region_of` and `normals` are kept; `corner_normals` and `exact_surface` of the mesh, which refer to the
// triangles of the file, are cleared if triangles were removed.
Simplification SimplifyMesh(size_t max_triangles, double max_error_m, RawMesh& mesh, SmoothSurface& surface);

}  // namespace evpose
