// SPDX-License-Identifier: Apache-2.0

// Turns the triangles of a file into a mesh with shared vertices and one winding (core/models/README.md, section 3).
#pragma once

#include <string>
#include <vector>

#include "core/mesh/types/raw_mesh.h"

namespace evpose {

// Diagonal of the bounding box, metres; 0 without points.
double BoundingBoxDiagonal(const RawMesh& model);

// Replaces points that are at most `tolerance_m` apart by the first of them (STL has no shared vertices). Drops
// triangles that are less high than the tolerance, lines of length zero and duplicates; `notices` say how many.
void Weld(double tolerance_m, RawMesh& model, std::vector<std::string>& notices);

// Gives neighbouring triangles the same winding. The normals of closed surfaces point outward; an open surface gets the
// winding that most of its triangles have. Surfaces that cannot be oriented (a Moebius strip) stay as they are.
// Vertices must be shared.
void OrientTriangles(RawMesh& model, std::vector<std::string>& notices);

}  // namespace evpose
