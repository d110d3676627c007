// SPDX-License-Identifier: Apache-2.0

// From triangles as a file has them to a mesh with shared vertices and one winding.
#pragma once

#include <string>
#include <vector>

#include "core/models/loading/raw_mesh.h"

namespace evpose {

// Diagonal of the bounding box, metres; 0 without points.
double BoundingBoxDiagonal(const RawMesh& model);

// Makes one of points that are at most `tolerance_m` apart (STL has no shared vertices at all), and drops triangles
// without an area, lines without a length, and what stands there twice; `notices` say what and how many.
void Weld(double tolerance_m, RawMesh& model, std::vector<std::string>& notices);

// Gives neighbouring triangles the same winding, and closed surfaces the one with the normals outward. Surfaces that
// cannot be oriented (a Moebius strip) stay as they are; open ones keep the winding that most of their triangles have.
// Vertices must be shared.
void OrientTriangles(RawMesh& model, std::vector<std::string>& notices);

}  // namespace evpose
