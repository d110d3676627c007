// SPDX-License-Identifier: Apache-2.0

// Removes triangles that lie within other triangles of the same plane (core/mesh/README.md, section 6).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/mesh/types/raw_mesh.h"

namespace evpose {

struct OverlapReport {
  size_t removed_triangles = 0;
  // RawMesh::covered_edges, if no triangle was removed.
  std::vector<std::array<uint32_t, 2>> covered_edges;
  bool is_complete = true;  // false: the limits on the work were reached, overlaps may remain
};

// Compares triangles of different shells (`shell_of` has one for each triangle; OrientTriangles()) in planes at most
// `tolerance_m` apart. Removes patches that others with the same winding cover, as copies with other diagonals or
// labels on a face. Walls between bodies that touch are two patches with opposite windings: both are removed if the
// rest is closed without them, and one of them if the surface continues beyond their common outline once. Keeps the two
// sides of a sheet.
OverlapReport RemoveOverlaps(double tolerance_m, absl::Span<const uint32_t> shell_of, RawMesh& mesh);

}  // namespace evpose
