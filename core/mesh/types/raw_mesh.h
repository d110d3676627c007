// SPDX-License-Identifier: Apache-2.0

// The mesh of a model file as its reader returns it, and the limits on its size.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/mesh/types/smooth_surface.h"

namespace evpose {

struct RawMesh {
  // Readers return coordinates in the unit of the file, rounded to single precision, which is that of a binary STL.
  std::vector<Eigen::Vector3d> points;
  std::vector<std::array<uint32_t, 3>> triangles;  // indices of points
  std::vector<std::array<uint32_t, 2>> lines;      // indices of points
  // The normals that the file states for the corners of the triangles, unit; zero for a corner without one. Empty if
  // the file states none.
  std::vector<std::array<Eigen::Vector3f, 3>> corner_normals;
  // The faces of the CAD model of which the mesh was made: exact normals and shapes. Empty if they are unknown.
  SmoothSurface exact_surface;
};

struct MeshLimits {
  // A polygon counts as the triangles into which it is cut, and a line element as a triangle.
  size_t max_triangles = 0;
};

// Counts the elements of a file while it is read, so that a file beyond the limits takes no further memory.
// Errors: INVALID_ARGUMENT, without the place in the file.
class ElementCounter {
 public:
  explicit ElementCounter(const MeshLimits& limits) : limits_(limits) {}

  // A face needs 3 to 512 corners.
  absl::Status AddFace(size_t corners);
  absl::Status AddLines(size_t count);

 private:
  absl::Status Add(size_t count);

  MeshLimits limits_;
  size_t elements_ = 0;
};

// Cuts a polygon of at least 3 corners, which are indices of `mesh.points`, into triangles with the winding of the
// polygon and appends them (core/models/README.md, section 2). The polygon may be concave and should be nearly flat.
// Parts of a polygon that crosses itself may be omitted.
void AppendPolygon(absl::Span<const uint32_t> corners, RawMesh& mesh);

}  // namespace evpose
