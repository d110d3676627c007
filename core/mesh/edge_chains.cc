// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/edge_chains.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "core/mesh/facet_graph.h"

namespace evpose {
namespace {

constexpr uint32_t kNoEdge = ~0u;

// Edges that deviate by less (rad) from the first one of a segment continue it: above the rounding errors of single
// precision, and as for straight lines (core/models/model_lines.cc).
constexpr double kStraightAngle = 2e-3;
// Largest turn (rad, 32 degrees) between chords of a curve. CAD programs limit it to 0.5 rad or less; a circle of 12
// chords turns by 30 degrees, an octagon, which is a polygon, by 45.
constexpr double kMaxChordTurn = 0.56;
// A chain along the edges of a scanned mesh turns by up to 75 degrees where the true curve is smooth. This limit
// applies to chains of at least so many edges that are each at most so long, relative to the diameter (6 px at 300 px).
constexpr double kMaxFineTurn = 1.31;
constexpr size_t kMinFineEdges = 10;
constexpr double kMaxFineLength = 0.02;
// A segment is a straight edge between curves if it is longer than its neighbours by this factor: chords of one curve
// differ less, because programs bound sagitta or angle.
constexpr double kMaxLengthRatio = 3.0;
constexpr size_t kMinSegments = 3;
// A part that turns less in all (rad, 2 degrees) is left to the straight lines, which follow it closely.
constexpr double kMinTotalTurn = 0.035;

class ChainFinder {
 public:
  ChainFinder(absl::Span<const EdgeEnds> edges, size_t num_vertices,
              absl::FunctionRef<bool(uint32_t, uint32_t)> may_join)
      : edges_(edges), at_(edges, num_vertices), may_join_(may_join), visited_(edges.size(), false) {}

  std::vector<EdgeChain> Find() {
    std::vector<EdgeChain> chains;
    for (const bool from_ends : {true, false}) {
      for (uint32_t edge = 0; edge < edges_.size(); ++edge) {
        if (visited_[edge]) continue;
        // A ring begins as its first edge does.
        const int begin = !from_ends || Next(edge, edges_[edge][0]) == kNoEdge ? 0 : 1;
        if (from_ends && Next(edge, edges_[edge][begin]) != kNoEdge) continue;
        chains.push_back(Walk(edge, edges_[edge][begin]));
      }
    }
    return chains;
  }

 private:
  // The edge that continues the chain at that end.
  uint32_t Next(uint32_t edge, uint32_t vertex) const {
    const absl::Span<const uint32_t> here = at_.At(vertex);
    if (here.size() != 2) return kNoEdge;
    const uint32_t other = here[0] == edge ? here[1] : here[0];
    return may_join_(edge, other) ? other : kNoEdge;
  }

  EdgeChain Walk(uint32_t edge, uint32_t vertex) {
    EdgeChain chain;
    chain.vertices.push_back(vertex);
    while (edge != kNoEdge && !visited_[edge]) {
      visited_[edge] = true;
      chain.edges.push_back(edge);
      vertex = edges_[edge][0] == vertex ? edges_[edge][1] : edges_[edge][0];
      chain.vertices.push_back(vertex);
      edge = Next(edge, vertex);
    }
    return chain;
  }

  const absl::Span<const EdgeEnds> edges_;
  const VertexEdges at_;
  const absl::FunctionRef<bool(uint32_t, uint32_t)> may_join_;
  std::vector<bool> visited_;
};

// Several edges of a chain in one direction.
struct ChainSegment {
  size_t first_edge = 0;  // index of the first edge of the chain
  size_t end_edge = 0;
  Eigen::Vector3d along = Eigen::Vector3d::Zero();  // unit
  double length_m = 0.0;
};

class CurveCutter {
 public:
  CurveCutter(absl::Span<const Eigen::Vector3d> points, double diameter_m, CurvedParts& result)
      : points_(points), diameter_m_(diameter_m), result_(result) {}

  void Cut(EdgeChain chain) {
    if (chain.edges.size() < kMinSegments) return;
    max_turn_ = IsFine(chain) ? kMaxFineTurn : kMaxChordTurn;
    if (chain.is_closed()) Rotate(chain);
    const std::vector<ChainSegment> segments = SegmentsOf(chain);
    const size_t count = segments.size();
    // Whether segment k continues the one before it as a curve does.
    std::vector<bool> joins(count + 1, false);
    for (size_t k = 1; k < count; ++k) joins[k] = Turn(segments[k - 1], segments[k]) <= max_turn_;
    const bool closes = chain.is_closed() && Turn(segments.back(), segments.front()) <= max_turn_;
    joins[0] = joins[count] = closes;
    std::vector<bool> is_chord(count);
    for (size_t k = 0; k < count; ++k) is_chord[k] = IsChord(segments, joins, k);
    for (size_t begin = 0; begin < count;) {
      size_t end = begin + 1;
      while (end < count && is_chord[end] == is_chord[begin] && joins[end]) ++end;
      if (is_chord[begin]) Add(chain, absl::MakeConstSpan(segments).subspan(begin, end - begin));
      begin = end;
    }
  }

 private:
  Eigen::Vector3d Vector(const EdgeChain& chain, size_t edge) const {
    return points_[chain.vertices[edge + 1]] - points_[chain.vertices[edge]];
  }

  static double Turn(const ChainSegment& a, const ChainSegment& b) { return AngleBetween(a.along, b.along); }

  bool IsFine(const EdgeChain& chain) const {
    if (chain.edges.size() < kMinFineEdges) return false;
    for (size_t k = 0; k < chain.edges.size(); ++k) {
      if (Vector(chain, k).norm() > kMaxFineLength * diameter_m_) return false;
    }
    return true;
  }

  // Lets a closed chain begin at a corner, or else with its longest edge, which is the straightest part.
  void Rotate(EdgeChain& chain) const {
    const size_t count = chain.edges.size();
    size_t first = 0;
    double longest_m = 0.0;
    for (size_t k = 0; k < count; ++k) {
      const Eigen::Vector3d here = Vector(chain, k), before = Vector(chain, (k + count - 1) % count);
      if (AngleBetween(before, here) > max_turn_) {
        first = k;
        break;
      }
      if (here.norm() <= longest_m) continue;
      longest_m = here.norm();
      first = k;
    }
    chain.vertices.pop_back();
    std::rotate(chain.vertices.begin(), chain.vertices.begin() + static_cast<std::ptrdiff_t>(first),
                chain.vertices.end());
    std::rotate(chain.edges.begin(), chain.edges.begin() + static_cast<std::ptrdiff_t>(first), chain.edges.end());
    chain.vertices.push_back(chain.vertices.front());
  }

  std::vector<ChainSegment> SegmentsOf(const EdgeChain& chain) const {
    std::vector<ChainSegment> segments;
    Eigen::Vector3d first = Eigen::Vector3d::Zero();
    for (size_t k = 0; k < chain.edges.size(); ++k) {
      const Eigen::Vector3d here = Vector(chain, k);
      if (segments.empty() || AngleBetween(first, here) > kStraightAngle) {
        first = here;
        segments.emplace_back().first_edge = k;
      }
      ChainSegment& last = segments.back();
      last.end_edge = k + 1;
      const Eigen::Vector3d whole = points_[chain.vertices[k + 1]] - points_[chain.vertices[last.first_edge]];
      last.length_m = whole.norm();
      last.along = whole.normalized();
    }
    return segments;
  }

  // Whether a segment may be a chord of a curve: it has a neighbour, and is not much longer than all its neighbours.
  static bool IsChord(const std::vector<ChainSegment>& segments, const std::vector<bool>& joins, size_t k) {
    double neighbour_m = 0.0;
    const size_t count = segments.size();
    if (joins[k]) neighbour_m = segments[(k + count - 1) % count].length_m;
    if (joins[k + 1]) neighbour_m = std::max(neighbour_m, segments[(k + 1) % count].length_m);
    return segments[k].length_m <= kMaxLengthRatio * neighbour_m;
  }

  void Add(const EdgeChain& chain, absl::Span<const ChainSegment> segments) {
    if (segments.size() < kMinSegments) return;
    double turn = 0.0;
    for (size_t k = 1; k < segments.size(); ++k) turn += Turn(segments[k - 1], segments[k]);
    if (turn < kMinTotalTurn) return;
    EdgeChain part;
    part.vertices.push_back(chain.vertices[segments[0].first_edge]);
    for (const ChainSegment& segment : segments) {
      part.vertices.push_back(chain.vertices[segment.end_edge]);
      part.edges.push_back(chain.edges[(segment.first_edge + segment.end_edge) / 2]);
      for (size_t k = segment.first_edge; k < segment.end_edge; ++k) result_.is_curved[chain.edges[k]] = true;
    }
    result_.chains.push_back(std::move(part));
  }

  const absl::Span<const Eigen::Vector3d> points_;
  const double diameter_m_;
  CurvedParts& result_;
  double max_turn_ = kMaxChordTurn;
};

}  // namespace

VertexEdges::VertexEdges(absl::Span<const EdgeEnds> edges, size_t num_vertices)
    : first_(num_vertices + 1, 0), edges_(2 * edges.size()) {
  for (const EdgeEnds& ends : edges) {
    for (const uint32_t vertex : ends) ++first_[vertex + 1];
  }
  std::partial_sum(first_.begin(), first_.end(), first_.begin());
  std::vector<uint32_t> next(first_.begin(), first_.end() - 1);
  for (uint32_t edge = 0; edge < edges.size(); ++edge) {
    for (const uint32_t vertex : edges[edge]) edges_[next[vertex]++] = edge;
  }
}

std::vector<EdgeChain> FindChains(absl::Span<const EdgeEnds> edges, size_t num_vertices,
                                  absl::FunctionRef<bool(uint32_t edge1, uint32_t edge2)> may_join) {
  return ChainFinder(edges, num_vertices, may_join).Find();
}

CurvedParts FindCurvedParts(absl::Span<const Eigen::Vector3d> points, absl::Span<const EdgeEnds> edges,
                            double diameter_m, absl::FunctionRef<bool(uint32_t edge1, uint32_t edge2)> may_join) {
  CurvedParts result;
  result.is_curved.assign(edges.size(), false);
  CurveCutter cutter(points, diameter_m, result);
  for (EdgeChain& chain : FindChains(edges, points.size(), may_join)) cutter.Cut(std::move(chain));
  return result;
}

}  // namespace evpose
