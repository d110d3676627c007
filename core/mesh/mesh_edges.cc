// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/mesh_edges.h"

#include <algorithm>
#include <numeric>
#include <optional>
#include <tuple>

namespace evpose {

std::vector<EdgeUse> SortedEdgeUses(absl::Span<const std::array<uint32_t, 3>> triangles) {
  uint32_t num_vertices = 0;
  for (const auto& triangle : triangles) {
    for (const uint32_t vertex : triangle) num_vertices = std::max(num_vertices, vertex + 1);
  }
  const auto for_each_use = [&](const auto& visit) {
    for (uint32_t t = 0; t < triangles.size(); ++t) {
      for (uint8_t side = 0; side < 3; ++side) {
        const uint32_t from = triangles[t][side], to = triangles[t][(side + 1) % 3];
        visit(EdgeUse{std::min(from, to), std::max(from, to), t, side, from < to});
      }
    }
  };
  // The uses are sorted by the lower vertex first, which has few edges: counting takes a fifth of the time of sorting
  // all.
  std::vector<size_t> end(num_vertices + 1, 0);
  for_each_use([&](const EdgeUse& use) { ++end[use.low + 1]; });
  std::partial_sum(end.begin(), end.end(), end.begin());
  std::vector<EdgeUse> uses(3 * triangles.size());
  for_each_use([&](const EdgeUse& use) { uses[end[use.low]++] = use; });
  for (size_t low = 0, begin = 0; low < num_vertices; begin = end[low++]) {
    std::sort(uses.begin() + begin, uses.begin() + end[low], [](const EdgeUse& a, const EdgeUse& b) {
      return std::tie(a.high, a.triangle, a.side) < std::tie(b.high, b.triangle, b.side);
    });
  }
  return uses;
}

absl::Span<const EdgeUse> UsesOfEdge(const std::vector<EdgeUse>& uses, uint32_t low, uint32_t high) {
  const auto [begin, end] = std::equal_range(
      uses.begin(), uses.end(), EdgeUse{low, high, 0, 0, false},
      [](const EdgeUse& a, const EdgeUse& b) { return std::tie(a.low, a.high) < std::tie(b.low, b.high); });
  return absl::MakeConstSpan(uses).subspan(begin - uses.begin(), end - begin);
}

std::vector<ExactSegment> ExactSegments(const RawMesh& mesh) {
  std::vector<ExactSegment> segments;
  if (mesh.exact_edges.empty()) return segments;
  std::vector<bool> is_vertex(mesh.points.size());
  for (const auto& triangle : mesh.triangles) {
    for (const uint32_t vertex : triangle) is_vertex[vertex] = true;
  }
  for (uint32_t e = 0; e < mesh.exact_edges.size(); ++e) {
    const std::vector<uint32_t>& points = mesh.exact_edges[e].points;
    std::optional<uint32_t> first;
    for (uint32_t i = 0; i < points.size(); ++i) {
      if (!is_vertex[points[i]]) continue;
      if (first.has_value() && points[*first] != points[i]) {
        const auto [low, high] = std::minmax(points[*first], points[i]);
        segments.push_back({low, high, e, *first, i});
      }
      first = i;
    }
  }
  const auto key = [](const ExactSegment& s) { return std::tie(s.low, s.high, s.edge, s.first); };
  std::sort(segments.begin(), segments.end(),
            [&](const ExactSegment& a, const ExactSegment& b) { return key(a) < key(b); });
  segments.erase(
      std::unique(segments.begin(), segments.end(),
                  [](const ExactSegment& a, const ExactSegment& b) { return a.low == b.low && a.high == b.high; }),
      segments.end());
  return segments;
}

const ExactSegment* FindExactSegment(const std::vector<ExactSegment>& segments, uint32_t low, uint32_t high) {
  const auto found =
      std::lower_bound(segments.begin(), segments.end(), std::tie(low, high),
                       [](const ExactSegment& s, const std::tuple<const uint32_t&, const uint32_t&>& ends) {
                         return std::tie(s.low, s.high) < ends;
                       });
  return found != segments.end() && found->low == low && found->high == high ? &*found : nullptr;
}

}  // namespace evpose
