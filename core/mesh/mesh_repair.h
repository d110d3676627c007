// SPDX-License-Identifier: Apache-2.0

// Repairs the mesh of a model file: one vertex for each corner, one surface in each place, one winding
// (core/mesh/README.md, sections 3 to 7).
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "core/mesh/types/raw_mesh.h"

namespace evpose {

// Removes the points that no triangle, line or exact edge uses, such as loose vertices of a PLY file, which would
// enlarge the object. The others keep their order. Returns the number of removed points.
size_t DropUnusedPoints(RawMesh& mesh);

struct RepairReport {
  size_t merged_points = 0;          // moved to another point; equal points do not count
  size_t split_edges = 0;            // sides of triangles that were split at a vertex of another triangle
  size_t degenerate_triangles = 0;   // removed
  size_t duplicate_triangles = 0;    // removed
  size_t overlapping_triangles = 0;  // removed: covered by others in their plane, or walls between bodies
  size_t inner_shells = 0;           // removed: inside a closed shell, where no camera sees them
  size_t inner_triangles = 0;        // of these shells
  size_t turned_triangles = 0;       // winding reversed
  size_t empty_lines = 0;            // removed
  size_t duplicate_lines = 0;        // removed
  size_t shells = 0;                 // surfaces: triangles that are connected across edges of two triangles
  bool is_closed = true;             // every shell encloses a volume
  bool is_oriented = true;           // every shell has two sides
  bool is_complete = true;           // false: limits on the work were reached, faults may remain
  bool is_searched = true;           // false: T-junctions were not searched, because there are too many loose edges
};

// Repairs a mesh in metres with finite points. Points within max(1e-5 of the diagonal, 4 roundings to single precision
// of the largest coordinate) become the first of them, and this distance is the tolerance of all other steps. A mesh
// without these faults keeps its points, its triangles and their order. Takes O(n log n) and bounded time and memory
// for any mesh.
RepairReport RepairMesh(RawMesh& mesh);

// Adds a notice for each kind of repair.
void DescribeRepair(const RepairReport& report, std::vector<std::string>& notices);

// Adds a notice if a diagonal above 5 m or below 5 mm makes another unit probable than `metres_per_unit`, which was
// applied to the mesh. For files that do not state their unit.
void NoteImplausibleSize(const RawMesh& in_metres, double metres_per_unit, std::vector<std::string>& notices);

}  // namespace evpose
