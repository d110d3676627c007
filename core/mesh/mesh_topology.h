// SPDX-License-Identifier: Apache-2.0

// Turns the triangles of a file into a mesh with shared vertices and one winding (core/mesh/README.md, sections 3 and
// 5). All functions keep `corner_normals` and `exact_surface` in step with the triangles.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/mesh/types/raw_mesh.h"

namespace evpose {

// Diagonal of the bounding box, metres; 0 without points.
double BoundingBoxDiagonal(const RawMesh& model);

// Replaces points that are at most `tolerance_m` apart by the first of them (STL has no shared vertices). The
// remaining points are farther apart from each other. Returns the number of points that moved, which leaves out equal
// ones.
size_t MergePoints(double tolerance_m, RawMesh& model);

double TriangleArea(const RawMesh& model, uint32_t triangle);  // m2

// Whether the triangle has three corners and is higher than the limit over its longest side.
bool HasArea(const RawMesh& model, const std::array<uint32_t, 3>& triangle, double min_height_m);

// Each removes elements and returns their number. A collapsed triangle has a vertex twice. Duplicate triangles have the
// same corners in the same cyclic order; the other side of a sheet has the reverse order.
size_t RemoveTriangles(const std::vector<bool>& remove, RawMesh& model);
size_t RemoveCollapsedTriangles(RawMesh& model);
size_t RemoveFlatTriangles(double min_height_m, RawMesh& model);
size_t RemoveDuplicateTriangles(RawMesh& model);
size_t RemoveEmptyLines(RawMesh& model);
size_t RemoveDuplicateLines(RawMesh& model);

// Programs that draw each face from both sides write each triangle twice, the second time with the reverse order of the
// corners. Removes these second triangles, except those of a sheet and those of a wall between two bodies (README,
// section 6). Returns the number of removed triangles. There must be no duplicate triangles.
size_t RemoveSecondSides(RawMesh& model);

struct Orientation {
  size_t turned = 0;               // triangles whose winding was reversed
  std::vector<uint32_t> shell_of;  // for each triangle, the surface that it belongs to
  size_t shells = 0;
  bool is_closed = true;    // every surface encloses a volume
  bool is_oriented = true;  // every surface has two sides, unlike a Moebius strip
};
// Gives neighbouring triangles, which are those on both sides of an edge of exactly two triangles, the same winding.
// Neighbours form a surface. The normals of closed surfaces, and of an open one with half of the area that is not
// nearly flat, point outward; other open surfaces get the winding that most of their triangles have (README, section
// 5). Surfaces that cannot be oriented stay as they are. Vertices must be shared.
Orientation OrientTriangles(RawMesh& model);

}  // namespace evpose
