// SPDX-License-Identifier: Apache-2.0

// The edges of a mesh with shared vertices, each with the triangles that have it as a side.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/mesh/types/raw_mesh.h"
#include "core/numerics/disjoint_sets.h"

namespace evpose {

// One side of one triangle, from the lower to the higher vertex.
struct EdgeUse {
  uint32_t low;
  uint32_t high;
  uint32_t triangle;
  uint8_t side;     // from corner `side` to the next one
  bool is_forward;  // the winding of the triangle goes from low to high
};

// All sides of all triangles, sorted by edge: the uses of an edge are consecutive.
std::vector<EdgeUse> SortedEdgeUses(absl::Span<const std::array<uint32_t, 3>> triangles);

// The uses of one edge, of all sorted ones.
absl::Span<const EdgeUse> UsesOfEdge(const std::vector<EdgeUse>& uses, uint32_t low, uint32_t high);

// The part of an exact edge between two successive vertices of triangles.
struct ExactSegment {
  uint32_t low, high;    // vertices
  uint32_t edge;         // index into RawMesh::exact_edges
  uint32_t first, last;  // indices into its points
};

// All segments, sorted by vertices; of several with the same vertices the first.
std::vector<ExactSegment> ExactSegments(const RawMesh& mesh);

// The segment between two vertices; nullptr if there is none.
const ExactSegment* FindExactSegment(const std::vector<ExactSegment>& segments, uint32_t low, uint32_t high);

// Calls `function` once for each edge, with its uses. A use has members `low` and `high`, by which `uses` are sorted.
template <typename Use, typename Function>  // void(absl::Span<const Use>)
void ForEachEdge(const std::vector<Use>& uses, const Function& function) {
  for (size_t begin = 0; begin < uses.size();) {
    size_t end = begin + 1;
    while (end < uses.size() && uses[end].low == uses[begin].low && uses[end].high == uses[begin].high) ++end;
    function(absl::MakeConstSpan(uses).subspan(begin, end - begin));
    begin = end;
  }
}

struct MarkedAtEdge {
  const EdgeUse* first = nullptr;  // the first marked triangle; nullptr if none is marked
  size_t rest = 0;                 // number of triangles that are not marked
};
// Joins the marked triangles at an edge in `patches`. Ignores those that are removed.
inline MarkedAtEdge JoinMarked(absl::Span<const EdgeUse> uses, const std::vector<bool>& marked,
                               const std::vector<bool>& removed, DisjointSets& patches) {
  MarkedAtEdge at_edge;
  for (const EdgeUse& use : uses) {
    if (removed[use.triangle]) continue;
    if (!marked[use.triangle]) {
      ++at_edge.rest;
    } else if (at_edge.first == nullptr) {
      at_edge.first = &use;
    } else {
      patches.Join(at_edge.first->triangle, use.triangle);
    }
  }
  return at_edge;
}

}  // namespace evpose
