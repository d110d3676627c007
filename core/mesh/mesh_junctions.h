// SPDX-License-Identifier: Apache-2.0

// Removes triangles without area and T-junctions from a mesh, without leaving holes (core/mesh/README.md, section 4).
#pragma once

#include <cstddef>

#include "core/mesh/types/raw_mesh.h"

namespace evpose {

struct JunctionReport {
  size_t split_edges = 0;           // sides of triangles that were split at vertices within them
  size_t degenerate_triangles = 0;  // removed
  size_t duplicate_triangles = 0;   // removed
  bool is_complete = true;          // false: junctions may remain
  bool is_within_limits = true;     // false: the limits on the work were reached
  bool is_searched = true;          // false: the search would exceed the limits in any case and was not begun
};

// Points must be farther apart than the tolerance, as after MergePoints(). Removes triangles that are at most
// `tolerance_m` high: the long side of one is split in its neighbours at the vertex beside it, so that they meet the
// neighbours of its short sides. A side of one triangle only is split where the end of another such side is within
// `tolerance_m` of its interior. Triangles keep their order; the parts of one take its place.
JunctionReport CloseJunctions(double tolerance_m, RawMesh& mesh);

}  // namespace evpose
