// SPDX-License-Identifier: Apache-2.0
#include "core/models/exact_curves.h"

#include <algorithm>
#include <cstdint>
#include <tuple>

#include "core/mesh/mesh_edges.h"

namespace evpose {
namespace {

// A segment that is an edge of the surface.
struct SeenSegment {
  ExactSegment segment;
  uint32_t edge;  // index of the edge of the surface
};

// Returns the segments in the order along the exact edges.
std::vector<SeenSegment> SeenSegments(const RawMesh& mesh, const SurfaceEdges& edges) {
  std::vector<SeenSegment> seen;
  const std::vector<ExactSegment> segments = ExactSegments(mesh);
  for (uint32_t e = 0; e < edges.edges.size(); ++e) {
    const MeshEdge& edge = edges.edges[e];
    if (edge.triangles.size() > 2) continue;  // where bodies meet
    const ExactSegment* segment = FindExactSegment(segments, edge.ends[0], edge.ends[1]);
    if (segment != nullptr) seen.push_back({*segment, e});
  }
  std::sort(seen.begin(), seen.end(), [](const SeenSegment& a, const SeenSegment& b) {
    return std::tie(a.segment.edge, a.segment.first) < std::tie(b.segment.edge, b.segment.first);
  });
  return seen;
}

}  // namespace

ExactCurves FindExactCurves(const RawMesh& mesh, const SurfaceEdges& edges) {
  ExactCurves result;
  result.is_straight.assign(edges.edges.size(), false);
  result.is_curved.assign(edges.edges.size(), false);
  if (mesh.exact_edges.empty()) return result;
  uint32_t edge = 0, next = 0;  // exact edge and point at which the last curve ended
  for (const auto& [segment, e] : SeenSegments(mesh, edges)) {
    const ExactEdge& exact = mesh.exact_edges[segment.edge];
    if (exact.shape == ExactEdge::Shape::kLine) {
      result.is_straight[e] = true;
      continue;
    }
    result.is_curved[e] = true;
    if (result.curves.empty() || edge != segment.edge || next != segment.first) {
      ExactCurves::Curve& curve = result.curves.emplace_back();
      if (exact.shape == ExactEdge::Shape::kCircle) curve.circle = exact.circle;
      curve.chain.vertices.push_back(exact.points[segment.first]);
    }
    EdgeChain& chain = result.curves.back().chain;
    for (uint32_t i = segment.first + 1; i <= segment.last; ++i) {
      if (exact.points[i] == chain.vertices.back()) continue;
      chain.vertices.push_back(exact.points[i]);
      chain.edges.push_back(e);
    }
    edge = segment.edge;
    next = segment.last;
  }
  return result;
}

}  // namespace evpose
