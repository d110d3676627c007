// SPDX-License-Identifier: Apache-2.0

// The surface of a model file for rendering: triangles with the normals of the smooth surface, divided until they
// follow it (core/simulation/README.md, section 4).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "core/models/object_model.h"

namespace evpose {

struct SmoothMesh {
  std::vector<Eigen::Vector3d> points;                  // object frame, metres
  std::vector<std::array<uint32_t, 3>> triangles;       // counter-clockwise seen from outside
  std::vector<std::array<Eigen::Vector3d, 3>> normals;  // unit, outward, of the surface at the corners of each triangle
};

// Takes the normals of the model's surface; those of the faces if it has none.
SmoothMesh MakeSmoothMesh(const ObjectModel& model);

// Divides triangles until no edge is longer than `max_edge_m` and the surface, which the normals determine, is nowhere
// farther than `tolerance_m` from the middle of an edge. Points that two triangles share remain shared, also on
// creases. Ends at 2 million triangles. A cylinder or sphere with exact normals keeps its exact radius.
void Subdivide(double tolerance_m, double max_edge_m, SmoothMesh& mesh);

// The painted lines and curves of a model as flat strips of the width `width_m` on their faces, in parts of at most
// `max_part_m`. Lines away from all faces have none, nor have lines along the border of an open surface, which has an
// edge there without paint. Ends at 2 million triangles.
SmoothMesh PaintedStrips(const ObjectModel& model, double width_m, double max_part_m);

// Whether each edge belongs to two triangles that run along it in opposite directions.
bool IsClosed(const SmoothMesh& mesh);

}  // namespace evpose
