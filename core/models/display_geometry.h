// SPDX-License-Identifier: Apache-2.0

// The geometry of an object model for a drawing of the object.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/models/object_model.h"

namespace evpose {

// Faces and edges of a model for a display, in the object frame, metres.
struct DisplayGeometry {
  std::vector<Eigen::Vector3f> vertices;              // those of `faces` only
  std::vector<std::array<uint32_t, 3>> faces;         // counter-clockwise seen from outside
  std::vector<std::array<Eigen::Vector3f, 2>> edges;  // straight lines, and the chords of curved edges
  bool is_simplified = false;                         // something is left out
};

// The limits of a geometry. With the defaults it is smaller than a message of 4 MB.
struct DisplayLimits {
  // With this number, a visible face covers some 7 square pixels of an object of 300 px in the image.
  size_t max_faces = 20'000;
  size_t max_edges = 50'000;          // the longest ones stay
  size_t max_mesh_bytes = 2'400'000;  // size of vertices and faces
};

// A mesh with more triangles than the limits allow is simplified by meshoptimizer: along the surface where that takes
// little time, else by merging the vertices in the cells of a grid. Takes up to a second for two million triangles.
DisplayGeometry MakeDisplayGeometry(const ObjectModel& model, const DisplayLimits& limits);

}  // namespace evpose
