// SPDX-License-Identifier: Apache-2.0

// Chains of edges that continue each other, and which of them are curved (core/mesh/README.md, section 11).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/types/span.h"

namespace evpose {

using EdgeEnds = std::array<uint32_t, 2>;  // indices of points; distinct

// The edges that end at each vertex, ascending.
class VertexEdges {
 public:
  VertexEdges(absl::Span<const EdgeEnds> edges, size_t num_vertices);

  absl::Span<const uint32_t> At(uint32_t vertex) const {
    return absl::MakeConstSpan(edges_).subspan(first_[vertex], first_[vertex + 1] - first_[vertex]);
  }

 private:
  std::vector<uint32_t> first_;
  std::vector<uint32_t> edges_;
};

struct EdgeChain {
  std::vector<uint32_t> vertices;  // one more than edges; if the chain is closed, the last one is the first one again
  std::vector<uint32_t> edges;

  bool is_closed() const { return vertices.front() == vertices.back(); }
};

// Joins edges at vertices where exactly two meet and `may_join` is true for them. First the chains with ends, then the
// rings, both in the order of their first edge.
std::vector<EdgeChain> FindChains(absl::Span<const EdgeEnds> edges, size_t num_vertices,
                                  absl::FunctionRef<bool(uint32_t edge1, uint32_t edge2)> may_join);

struct CurvedParts {
  std::vector<EdgeChain> chains;  // segments instead of edges: `edges` has the edge in the middle of each
  std::vector<bool> is_curved;    // for each edge, whether it belongs to a chain
};

// Finds the curved parts of the chains: at least three successive segments, joined by small turns, of which none is
// much longer than its neighbours. Edges that continue each other straight are one segment.
CurvedParts FindCurvedParts(absl::Span<const Eigen::Vector3d> points, absl::Span<const EdgeEnds> edges,
                            double diameter_m, absl::FunctionRef<bool(uint32_t edge1, uint32_t edge2)> may_join);

}  // namespace evpose
