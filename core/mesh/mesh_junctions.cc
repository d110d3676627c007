// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/mesh_junctions.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstdint>
#include <tuple>
#include <utility>
#include <vector>

#include "absl/types/span.h"
#include "core/base/yield_point.h"
#include "core/mesh/box_tree.h"
#include "core/mesh/mesh_edges.h"
#include "core/mesh/mesh_topology.h"

namespace evpose {
namespace {

// Real files need two or three: the last one finds nothing. Vertices whose distance is near the tolerance can need
// splits that alternate without end.
constexpr int kMaxRounds = 6;
// Vertices that may be inserted into sides, per triangle of a small and in total for a large mesh: bounds memory. In
// the worst real file seen, a cube whose every edge has a T-junction, 3 triangles in 4 are split.
constexpr size_t kMaxSplitsPerTriangle = 4;
constexpr size_t kSplitsForAnySize = 1'000'000;
// Nodes of the tree that all searches may visit, per triangle. A search among edges of similar sizes visits about 60.
// Beyond a number of nodes fewer are allowed, because those of a large tree are not in the cache.
constexpr size_t kNodesPerTriangle = 400;
constexpr size_t kNodesForAnySize = 20'000'000;
constexpr size_t kNodesPerLateTriangle = 20;

// A vertex on an edge, at a share of the way from its lower to its higher end.
struct Insertion {
  uint32_t low, high;
  double share;
  uint32_t vertex;
};

// The insertions into one side of a triangle.
struct SplitSide {
  uint32_t triangle;
  uint8_t side;
  bool is_forward;
  absl::Span<const Insertion> insertions;
};

// A part of a triangle, with the splits of its sides that are still to be made.
struct Part {
  std::array<uint32_t, 3> corners;
  std::array<std::array<Eigen::Vector3f, 3>, 2> normals;  // stated and exact ones
  std::array<const SplitSide*, 3> splits;
};

// The direction between two normals at a share of the way; zero if one of them is missing.
Eigen::Vector3f BlendNormals(const Eigen::Vector3f& a, const Eigen::Vector3f& b, double share) {
  if (a.isZero(0.0f) || b.isZero(0.0f)) return Eigen::Vector3f::Zero();
  return StatedNormal((1.0 - share) * a.cast<double>() + share * b.cast<double>());
}

class JunctionCloser {
 public:
  JunctionCloser(double tolerance_m, RawMesh& mesh) : tolerance_m_(tolerance_m), mesh_(mesh) {
    const size_t count = mesh.triangles.size();
    splits_left_ = std::max(count, std::min(kMaxSplitsPerTriangle * count, kSplitsForAnySize));
    nodes_left_ = std::min(kNodesPerTriangle * count, kNodesForAnySize + kNodesPerLateTriangle * count);
  }

  JunctionReport Close() {
    bool has_changed = true;
    // Each round costs as much again; one that has reached the limits on the work is the last.
    for (int round = 0; has_changed && report_.is_complete && round < kMaxRounds; ++round) has_changed = CloseSome();
    report_.is_within_limits = report_.is_complete;
    if (has_changed) {
      report_.is_complete = false;
      report_.degenerate_triangles += RemoveFlatTriangles(tolerance_m_, mesh_);
    }
    return report_;
  }

 private:
  // Returns whether the mesh changed.
  bool CloseSome() {
    uses_ = SortedEdgeUses(mesh_.triangles);
    insertions_.clear();
    remove_.assign(mesh_.triangles.size(), false);
    ChooseFlatTriangles();
    FindJunctions();
    const auto key = [](const Insertion& i) { return std::tie(i.low, i.high, i.share, i.vertex); };
    std::sort(insertions_.begin(), insertions_.end(),
              [&](const Insertion& a, const Insertion& b) { return key(a) < key(b); });
    insertions_.erase(std::unique(insertions_.begin(), insertions_.end(),
                                  [&](const Insertion& a, const Insertion& b) { return key(a) == key(b); }),
                      insertions_.end());
    const size_t removed = std::count(remove_.begin(), remove_.end(), true);
    if (removed == 0 && insertions_.empty()) return false;
    SplitTriangles();
    report_.degenerate_triangles += removed;
    report_.duplicate_triangles += RemoveDuplicateTriangles(mesh_);
    return true;
  }

  // `sides` is the number of triangles that the vertex splits.
  void Insert(uint32_t vertex, uint32_t low, uint32_t high, size_t sides) {
    if (splits_left_ < sides) {
      report_.is_complete = false;
      return;
    }
    splits_left_ -= sides;
    const Eigen::Vector3d edge = mesh_.points[high] - mesh_.points[low];
    insertions_.push_back(
        {low, high, (mesh_.points[vertex] - mesh_.points[low]).dot(edge) / edge.squaredNorm(), vertex});
  }

  // Chooses triangles without area that do not share their long sides with others chosen: those have to be split first.
  void ChooseFlatTriangles() {
    std::vector<bool> is_neighbour(mesh_.triangles.size(), false);
    for (uint32_t t = 0; t < mesh_.triangles.size(); ++t) {
      if (HasArea(mesh_, mesh_.triangles[t], tolerance_m_) || is_neighbour[t]) continue;
      const int side = LongestSide(mesh_.triangles[t]);
      const auto& corners = mesh_.triangles[t];
      const auto [low, high] = std::minmax(corners[side], corners[(side + 1) % 3]);
      const absl::Span<const EdgeUse> uses = UsesOfEdge(uses_, low, high);
      if (std::any_of(uses.begin(), uses.end(), [this](const EdgeUse& use) { return remove_[use.triangle]; })) continue;
      for (const EdgeUse& use : uses) is_neighbour[use.triangle] = true;
      remove_[t] = true;
      if (uses.size() > 1) Insert(corners[(side + 2) % 3], low, high, uses.size() - 1);
    }
  }

  int LongestSide(const std::array<uint32_t, 3>& corners) const {
    int longest = 0;
    double longest2 = 0.0;
    for (int side = 0; side < 3; ++side) {
      const double length2 = (mesh_.points[corners[(side + 1) % 3]] - mesh_.points[corners[side]]).squaredNorm();
      if (length2 <= longest2) continue;
      longest2 = length2;
      longest = side;
    }
    return longest;
  }

  void FindJunctions() {
    std::vector<EdgeUse> edges;
    ForEachEdge(uses_, [&](absl::Span<const EdgeUse> uses) {
      if (uses.size() == 1 && !remove_[uses[0].triangle]) edges.push_back(uses[0]);
    });
    std::vector<Eigen::AlignedBox3f> boxes;
    std::vector<uint32_t> vertices;
    for (const EdgeUse& edge : edges) {
      Eigen::AlignedBox3d box(mesh_.points[edge.low]);
      boxes.push_back(box.extend(mesh_.points[edge.high]).cast<float>());
      vertices.insert(vertices.end(), {edge.low, edge.high});
    }
    std::sort(vertices.begin(), vertices.end());
    vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
    const BoxTree tree(boxes);
    for (const uint32_t vertex : vertices) {
      YieldPoint(vertex);
      // The tolerance is at least eight roundings of a coordinate to float.
      const Eigen::Vector3d margin = Eigen::Vector3d::Constant(2.0 * tolerance_m_);
      const Eigen::Vector3d& point = mesh_.points[vertex];
      const Eigen::AlignedBox3d around(point - margin, point + margin);
      const bool was_complete = tree.VisitMeeting(around.cast<float>(), nodes_left_, [&](uint32_t i) {
        if (IsWithin(vertex, edges[i])) Insert(vertex, edges[i].low, edges[i].high, 1);
      });
      if (!was_complete) report_.is_complete = false;
    }
  }

  bool IsWithin(uint32_t vertex, const EdgeUse& edge) const {
    if (vertex == edge.low || vertex == edge.high) return false;
    if (vertex == mesh_.triangles[edge.triangle][(edge.side + 2) % 3]) return false;
    const Eigen::Vector3d from_low = mesh_.points[vertex] - mesh_.points[edge.low];
    const Eigen::Vector3d along = mesh_.points[edge.high] - mesh_.points[edge.low];
    const double share = from_low.dot(along) / along.squaredNorm();
    return share > 0.0 && share < 1.0 && (from_low - share * along).squaredNorm() <= tolerance_m_ * tolerance_m_;
  }

  // The splits in the order of the triangles.
  std::vector<SplitSide> SplitSides() const {
    std::vector<SplitSide> sides;
    for (size_t begin = 0; begin < insertions_.size();) {
      size_t end = begin;
      const uint32_t low = insertions_[begin].low, high = insertions_[begin].high;
      while (end < insertions_.size() && insertions_[end].low == low && insertions_[end].high == high) ++end;
      for (const EdgeUse& use : UsesOfEdge(uses_, low, high)) {
        sides.push_back(
            {use.triangle, use.side, use.is_forward, absl::MakeConstSpan(insertions_).subspan(begin, end - begin)});
      }
      begin = end;
    }
    std::sort(sides.begin(), sides.end(), [](const SplitSide& a, const SplitSide& b) {
      return std::tie(a.triangle, a.side) < std::tie(b.triangle, b.side);
    });
    return sides;
  }

  void SplitTriangles() {
    const std::vector<SplitSide> sides = SplitSides();
    RawMesh old;
    old.triangles.swap(mesh_.triangles);
    old.corner_normals.swap(mesh_.corner_normals);
    old.exact_surface.region_of.swap(mesh_.exact_surface.region_of);
    old.exact_surface.normals.swap(mesh_.exact_surface.normals);
    size_t next = 0;
    for (uint32_t t = 0; t < old.triangles.size(); ++t) {
      Part part{old.triangles[t], {}, {}};
      if (!old.corner_normals.empty()) part.normals[0] = old.corner_normals[t];
      if (!old.exact_surface.normals.empty()) part.normals[1] = old.exact_surface.normals[t];
      for (; next < sides.size() && sides[next].triangle == t; ++next) {
        part.splits[sides[next].side] = &sides[next];
        if (!remove_[t]) ++report_.split_edges;
      }
      if (!remove_[t]) AppendParts(part, old, t);
    }
  }

  // Appends the triangle, or the fan from the corner opposite to its first side that is split. The outer two parts of
  // the fan have the other sides, which are split in turn.
  void AppendParts(const Part& part, const RawMesh& old, uint32_t t) {
    const auto split = std::find_if(part.splits.begin(), part.splits.end(), [](const auto* s) { return s != nullptr; });
    if (split == part.splits.end()) {
      mesh_.triangles.push_back(part.corners);
      if (!old.corner_normals.empty()) mesh_.corner_normals.push_back(part.normals[0]);
      if (!old.exact_surface.normals.empty()) mesh_.exact_surface.normals.push_back(part.normals[1]);
      if (!old.exact_surface.region_of.empty()) {
        mesh_.exact_surface.region_of.push_back(old.exact_surface.region_of[t]);
      }
      return;
    }
    const size_t a = split - part.splits.begin(), b = (a + 1) % 3, c = (a + 2) % 3;
    std::vector<std::pair<uint32_t, double>> chain = {{part.corners[a], 0.0}};
    for (const Insertion& insertion : (*split)->insertions) {
      if (insertion.vertex == part.corners[c]) continue;  // the triangle is flat itself
      chain.push_back({insertion.vertex, (*split)->is_forward ? insertion.share : 1.0 - insertion.share});
    }
    if (!(*split)->is_forward) std::reverse(chain.begin() + 1, chain.end());
    chain.push_back({part.corners[b], 1.0});
    for (size_t i = 0; i + 1 < chain.size(); ++i) {
      Part child{{chain[i].first, chain[i + 1].first, part.corners[c]}, {}, {}};
      for (size_t kind = 0; kind < part.normals.size(); ++kind) {
        if (kind == 0 ? old.corner_normals.empty() : old.exact_surface.normals.empty()) continue;
        const auto& normals = part.normals[kind];
        const auto at = [&](double share) { return BlendNormals(normals[a], normals[b], share); };
        child.normals[kind] = {i == 0 ? normals[a] : at(chain[i].second),
                               i + 2 == chain.size() ? normals[b] : at(chain[i + 1].second), normals[c]};
      }
      if (i + 2 == chain.size()) child.splits[1] = part.splits[b];
      if (i == 0) child.splits[2] = part.splits[c];
      AppendParts(child, old, t);
    }
  }

  const double tolerance_m_;
  RawMesh& mesh_;
  size_t splits_left_;  // triangles that may be added
  size_t nodes_left_;   // of the search
  std::vector<EdgeUse> uses_;
  std::vector<Insertion> insertions_;
  std::vector<bool> remove_;  // triangles
  JunctionReport report_;
};

}  // namespace

JunctionReport CloseJunctions(double tolerance_m, RawMesh& mesh) { return JunctionCloser(tolerance_m, mesh).Close(); }

}  // namespace evpose
