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

// Largest number of rounds. Real files need two or three rounds; the last one splits nothing. If the distance of
// vertices is near the tolerance, the splits of successive rounds can alternate without end.
constexpr int kMaxRounds = 6;
// From this round on, flat triangles are removed only if fewer remain: on an arc of vertices that are all within the
// tolerance of its chords, each removal moves the next flat triangle by one vertex.
constexpr int kLateRound = 3;
// Vertices that may be inserted into sides, per triangle of a small and in total for a large mesh: bounds memory. In
// the worst real file seen, a cube whose every edge has a T-junction, 3 triangles in 4 are split.
constexpr size_t kMaxSplitsPerTriangle = 4;
constexpr size_t kSplitsForAnySize = 1'000'000;
// Nodes of the tree that all searches may visit, per triangle. A search among edges of similar sizes visits about 60.
// Beyond a number of nodes fewer are allowed, because those of a large tree are not in the cache.
constexpr size_t kNodesPerTriangle = 400;
constexpr size_t kNodesForAnySize = 20'000'000;
constexpr size_t kNodesPerLateTriangle = 20;
// Cost, in nodes, of the comparison of a vertex with an edge whose box contains it. The number of these comparisons can
// be large: the boxes of thin triangles around one axis contain the ends of all the others.
constexpr size_t kNodesPerJunctionTest = 4;
constexpr uint32_t kNoVertex = ~0u;
// Height, relative to the tolerance, of a triangle that may remain at the end: a flatter one has no usable normal.
constexpr double kMinHeightOfRest = 1e-3;

// A vertex on an edge, at a share of the way from its lower to its higher end. Of equal shares, the lower rank is
// first.
struct Insertion {
  uint32_t low, high;
  double share;
  uint32_t rank;
  uint32_t vertex;
};

// A triangle without area: its longest side, its third vertex and the distance between them.
struct FlatTriangle {
  double length2;
  uint32_t triangle;
  uint32_t low, high;
  uint32_t apex;
  double height_m;
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
    for (int round = 0; has_changed && report_.is_complete && round < kMaxRounds; ++round) {
      is_late_ = round >= kLateRound;
      has_changed = CloseSome();
    }
    report_.is_within_limits = report_.is_complete;
    // Flat triangles that remain do no harm, unless they have no normal; junctions that remain are slits.
    const size_t without_normal = RemoveFlatTriangles(kMinHeightOfRest * tolerance_m_, mesh_);
    report_.degenerate_triangles += without_normal;
    report_.is_complete &= !(has_changed && has_junctions_) && without_normal == 0;
    return report_;
  }

 private:
  using Ends = std::array<uint32_t, 2>;  // ends of an edge, the lower one first
  // The effect of the removal of flat triangles at an edge.
  struct RemovedAt {
    bool is_split = false;        // a triangle with this longest side was removed
    uint32_t apex = 0;            // its third vertex
    double distance_m = 0.0;      // largest distance of the edge from the triangle that becomes its neighbour
    uint32_t beyond = kNoVertex;  // the third vertex of that
  };

  // Returns whether the mesh changed.
  bool CloseSome() {
    uses_ = SortedEdgeUses(mesh_.triangles);
    insertions_.clear();
    remove_.assign(mesh_.triangles.size(), false);
    ChooseFlatTriangles();
    const size_t num_insertions = insertions_.size();
    FindJunctions();
    has_junctions_ = insertions_.size() > num_insertions;
    const auto key = [](const Insertion& i) { return std::tie(i.low, i.high, i.share, i.rank, i.vertex); };
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
  void Insert(const Insertion& insertion, size_t sides) {
    if (splits_left_ < sides) {
      report_.is_complete = false;
      return;
    }
    splits_left_ -= sides;
    insertions_.push_back(insertion);
  }

  double ShareOf(uint32_t vertex, uint32_t low, uint32_t high) const {
    const Eigen::Vector3d edge = mesh_.points[high] - mesh_.points[low];
    return (mesh_.points[vertex] - mesh_.points[low]).dot(edge) / edge.squaredNorm();
  }

  // The triangles without area, by decreasing length.
  std::vector<FlatTriangle> FlatTriangles() const {
    std::vector<FlatTriangle> flat;
    for (uint32_t t = 0; t < mesh_.triangles.size(); ++t) {
      const auto& corners = mesh_.triangles[t];
      if (HasArea(mesh_, corners, tolerance_m_)) continue;
      const int side = LongestSide(corners);
      const auto [low, high] = std::minmax(corners[side], corners[(side + 1) % 3]);
      const double length2 = (mesh_.points[high] - mesh_.points[low]).squaredNorm();
      flat.push_back({length2, t, low, high, corners[(side + 2) % 3], HeightOf(corners)});
    }
    std::sort(flat.begin(), flat.end(), [](const FlatTriangle& a, const FlatTriangle& b) {
      return a.length2 != b.length2 ? a.length2 > b.length2 : a.triangle < b.triangle;
    });
    return flat;
  }

  // Chooses triangles without area and lists the vertices that split the others at their longest sides. One at a short
  // side of another comes after it: the former's vertex then splits what was beside the latter.
  void ChooseFlatTriangles() {
    const std::vector<FlatTriangle> flat = FlatTriangles();
    flat_edges_.clear();
    for (const FlatTriangle& triangle : flat) {
      flat_edges_.push_back({triangle.low, triangle.high});
      for (const Ends& side : ShorterSides(triangle)) flat_edges_.push_back(side);
    }
    std::sort(flat_edges_.begin(), flat_edges_.end());
    flat_edges_.erase(std::unique(flat_edges_.begin(), flat_edges_.end()), flat_edges_.end());
    removed_at_.assign(flat_edges_.size(), {});
    for (const FlatTriangle& triangle : flat) ChooseFlatTriangle(triangle);
    for (size_t i = 0; i < flat_edges_.size(); ++i) {
      if (!removed_at_[i].is_split) continue;
      const absl::Span<const EdgeUse> uses = UsesOfEdge(uses_, flat_edges_[i][0], flat_edges_[i][1]);
      const size_t rest =
          std::count_if(uses.begin(), uses.end(), [this](const EdgeUse& use) { return !remove_[use.triangle]; });
      if (rest > 0) InsertAlong(flat_edges_[i], rest);
    }
  }

  void ChooseFlatTriangle(const FlatTriangle& flat) {
    RemovedAt& longest = *FindRemovedAt({flat.low, flat.high});
    const std::array<Ends, 2> shorter = ShorterSides(flat);
    const double distance_m = longest.distance_m + flat.height_m;
    // Vertices farther away might be beyond the triangle that they split.
    if (longest.is_split || distance_m > tolerance_m_) return;
    for (const Ends& side : shorter) {
      if (FindRemovedAt(side)->is_split) return;  // it is as long
    }
    const uint32_t beyond = longest.beyond != kNoVertex ? longest.beyond : VertexBeyond(flat);
    if (beyond != kNoVertex && !Improves(flat, beyond)) return;
    longest.is_split = true;
    longest.apex = flat.apex;
    remove_[flat.triangle] = true;
    for (const Ends& side : shorter) {
      RemovedAt& at = *FindRemovedAt(side);
      at.distance_m = std::max(at.distance_m, distance_m);
      at.beyond = beyond;
    }
  }

  // The third vertex of another triangle at the longest side; kNoVertex at a boundary.
  uint32_t VertexBeyond(const FlatTriangle& flat) const {
    for (const EdgeUse& use : UsesOfEdge(uses_, flat.low, flat.high)) {
      if (use.triangle != flat.triangle) return mesh_.triangles[use.triangle][(use.side + 2) % 3];
    }
    return kNoVertex;
  }

  // Whether the lower of the flat triangle and its neighbour is lower than both parts of the neighbour. Without this
  // condition, triangles between the vertices of a flat arc would replace each other without end, because any two of
  // them may have one that is flat. If both have the same longest side, those of their parts are shorter.
  bool Improves(const FlatTriangle& flat, uint32_t beyond) const {
    const std::array<uint32_t, 3> neighbour = {flat.low, flat.high, beyond};
    const int side = LongestSide(neighbour);
    if (side == 0 && !HasArea(mesh_, neighbour, tolerance_m_)) return true;
    const double before_m = std::min(flat.height_m, HeightOf(neighbour));
    const double after_m = std::min(HeightOf({flat.low, flat.apex, beyond}), HeightOf({flat.apex, flat.high, beyond}));
    if (is_late_ && before_m > kMinHeightOfRest * tolerance_m_) return after_m > tolerance_m_;
    return after_m > before_m;
  }

  // Height over the longest side.
  double HeightOf(const std::array<uint32_t, 3>& corners) const {
    const int side = LongestSide(corners);
    const Eigen::Vector3d& from = mesh_.points[corners[side]];
    const Eigen::Vector3d along = mesh_.points[corners[(side + 1) % 3]] - from;
    return along.normalized().cross(mesh_.points[corners[(side + 2) % 3]] - from).norm();
  }

  // nullptr for an edge of no flat triangle.
  RemovedAt* FindRemovedAt(const Ends& ends) {
    const auto found = std::lower_bound(flat_edges_.begin(), flat_edges_.end(), ends);
    if (found == flat_edges_.end() || *found != ends) return nullptr;
    return &removed_at_[found - flat_edges_.begin()];
  }

  // Inserts the vertices of the triangles removed at an edge and, between them, at their shorter sides, in their order.
  // `sides` is the number of triangles that they split.
  void InsertAlong(const Ends& ends, size_t sides) {
    std::vector<Ends> open = {ends};  // directed parts of the edge, the next one last
    double share = 0.0;
    uint32_t rank = 0;
    while (!open.empty() && splits_left_ >= sides) {
      const auto [from, to] = open.back();
      open.pop_back();
      const RemovedAt* at = FindRemovedAt({std::min(from, to), std::max(from, to)});
      if (at != nullptr && at->is_split) {
        open.push_back({at->apex, to});
        open.push_back({from, at->apex});
      } else if (to != ends[1]) {
        share = std::clamp(ShareOf(to, ends[0], ends[1]), share, 1.0);
        Insert({ends[0], ends[1], share, rank++, to}, sides);
      }
    }
    report_.is_complete &= open.empty();
  }

  static std::array<Ends, 2> ShorterSides(const FlatTriangle& flat) {
    const auto side = [&](uint32_t end) { return Ends{std::min(end, flat.apex), std::max(end, flat.apex)}; };
    return {side(flat.low), side(flat.high)};
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
    std::vector<uint32_t> vertices;
    for (const EdgeUse& edge : edges) vertices.insert(vertices.end(), {edge.low, edge.high});
    std::sort(vertices.begin(), vertices.end());
    vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
    // A search that cannot end within the limit is not begun: for a million triangles without neighbours it would take
    // seconds.
    if (vertices.size() * BoxTree::LeastNodes(edges.size()) > nodes_left_) {
      report_.is_complete = report_.is_searched = false;
      return;
    }
    std::vector<Eigen::AlignedBox3f> boxes;
    for (const EdgeUse& edge : edges) {
      Eigen::AlignedBox3d box(mesh_.points[edge.low]);
      boxes.push_back(box.extend(mesh_.points[edge.high]).cast<float>());
    }
    const BoxTree tree(boxes);
    for (const uint32_t vertex : vertices) {
      YieldPoint(vertex);
      // The tolerance is at least eight roundings of a coordinate to float.
      const Eigen::Vector3d margin = Eigen::Vector3d::Constant(2.0 * tolerance_m_);
      const Eigen::Vector3d& point = mesh_.points[vertex];
      const Eigen::AlignedBox3d around(point - margin, point + margin);
      const bool was_complete = tree.VisitMeeting(around.cast<float>(), nodes_left_, [&](uint32_t i) {
        const auto& [low, high, triangle, side, is_forward] = edges[i];
        nodes_left_ -= std::min(nodes_left_, kNodesPerJunctionTest);
        if (IsWithin(vertex, edges[i])) Insert({low, high, ShareOf(vertex, low, high), 0, vertex}, 1);
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
  size_t nodes_left_;   // number of nodes that the search may still visit
  std::vector<EdgeUse> uses_;
  std::vector<Ends> flat_edges_;       // edges of the triangles without area, sorted
  std::vector<RemovedAt> removed_at_;  // what is removed at each of `flat_edges_`
  std::vector<Insertion> insertions_;
  bool is_late_ = false;
  bool has_junctions_ = false;  // the last round has found some
  std::vector<bool> remove_;    // triangles
  JunctionReport report_;
};

}  // namespace

JunctionReport CloseJunctions(double tolerance_m, RawMesh& mesh) { return JunctionCloser(tolerance_m, mesh).Close(); }

}  // namespace evpose
