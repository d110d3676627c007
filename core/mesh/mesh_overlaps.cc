// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/mesh_overlaps.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <numeric>
#include <utility>
#include <vector>

#include "absl/container/inlined_vector.h"
#include "core/base/yield_point.h"
#include "core/mesh/box_tree.h"
#include "core/mesh/mesh_edges.h"
#include "core/mesh/mesh_topology.h"
#include "core/numerics/disjoint_sets.h"

namespace evpose {
namespace {

// Limits on the work, on average for each triangle, which are twice what real files need: nodes of the tree that its
// search visits, triangles that overlap it, and cuts of its pieces by one of them. A comparison of two triangles counts
// as some nodes, because it takes as long.
constexpr size_t kOverlapNodesPerSearch = 400;
// Beyond this number of nodes fewer are allowed, because those of a large tree are not in the cache.
constexpr size_t kOverlapNodesForAnySize = 20'000'000;
constexpr size_t kOverlapNodesPerLateSearch = 20;
constexpr size_t kNodesPerComparison = 8;
constexpr size_t kOverlapsPerTriangle = 8;
constexpr size_t kCutsPerTriangle = 8;
// Small meshes may spend as much on a single triangle.
constexpr size_t kCutsForAnySize = 100'000;
// Cosine of the largest angle (8 degrees) between planes that count as one: the normals of narrow triangles are
// inaccurate, and the distances of the corners decide.
constexpr double kSamePlaneCosine = 0.99;

using Polygon2d = absl::InlinedVector<Eigen::Vector2d, 8>;  // two triangles have at most six corners in common
using Triangle2d = std::array<Eigen::Vector2d, 3>;

double Cross2d(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

// Distance of a point to the left of the line from `a` to `b`.
double DistanceToLeft(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& point) {
  return Cross2d(b - a, point - a) / (b - a).norm();
}

// Whether a side of the first triangle, which is counter-clockwise, separates it from the second, up to the tolerance.
bool SeparatesBySide(const Triangle2d& triangle, const Triangle2d& other, double tolerance_m) {
  for (size_t i = 0; i < 3; ++i) {
    const auto is_outside = [&](const Eigen::Vector2d& point) {
      return DistanceToLeft(triangle[i], triangle[(i + 1) % 3], point) <= tolerance_m;
    };
    if (std::all_of(other.begin(), other.end(), is_outside)) return true;
  }
  return false;
}

double PolygonArea(const Polygon2d& polygon) {
  double twice = 0.0;
  for (size_t i = 2; i < polygon.size(); ++i) twice += Cross2d(polygon[i - 1] - polygon[0], polygon[i] - polygon[0]);
  return 0.5 * twice;
}

// The part of a convex polygon on one side of a line (Sutherland and Hodgman, 1974).
Polygon2d ClipPolygon(const Polygon2d& polygon, const Eigen::Vector2d& a, const Eigen::Vector2d& b, bool keep_left) {
  Polygon2d kept;
  const auto height = [&](const Eigen::Vector2d& point) {
    return (keep_left ? 1.0 : -1.0) * Cross2d(b - a, point - a);
  };
  for (size_t i = 0; i < polygon.size(); ++i) {
    const Eigen::Vector2d &from = polygon[i], &to = polygon[(i + 1) % polygon.size()];
    const double height_from = height(from), height_to = height(to);
    if (height_from >= 0.0) kept.push_back(from);
    if ((height_from < 0.0) != (height_to < 0.0)) {
      kept.push_back(from + height_from / (height_from - height_to) * (to - from));
    }
  }
  return kept;
}

Polygon2d ClipByTriangle(Polygon2d polygon, const Triangle2d& triangle) {
  for (size_t i = 0; i < 3; ++i) polygon = ClipPolygon(polygon, triangle[i], triangle[(i + 1) % 3], /*keep_left=*/true);
  return polygon;
}

// Takes `cost` from the budget. Returns false, and sets the budget to 0, if it does not suffice.
bool Spend(size_t cost, size_t& budget) {
  const bool suffices = budget >= cost;
  budget -= std::min(cost, budget);
  return suffices;
}

// Whether counter-clockwise triangles cover a triangle up to a strip along its sides that is one tolerance wide. Each
// piece that is cut from the triangle takes one from `budget`. Returns false if the budget does not suffice.
bool AreCovering(const std::vector<Triangle2d>& covers, const Triangle2d& triangle, double tolerance_m,
                 size_t& budget) {
  double perimeter = 0.0;
  for (size_t i = 0; i < 3; ++i) perimeter += (triangle[(i + 1) % 3] - triangle[i]).norm();
  std::vector<Polygon2d> pieces(1, Polygon2d(triangle.begin(), triangle.end())), rest;
  // The area of the strip, at most a hundredth of the triangle: a narrow triangle would lie in the strip as a whole.
  const double total = PolygonArea(pieces[0]), negligible = std::min(tolerance_m * perimeter, 0.01 * total);
  if (!Spend(covers.size(), budget)) return false;
  // The covered area is at most the sum of the areas of the covers, and at most the sum of the areas that the triangle
  // has in common with each of them. These bounds reject most triangles that are partly covered. Cutting a triangle
  // into pieces takes longer, because each further cover increases the number of pieces. The factor of the first bound
  // is a margin for roundings.
  double area = 0.0;
  for (const Triangle2d& cover : covers) area += 0.5 * Cross2d(cover[1] - cover[0], cover[2] - cover[0]);
  if (area < 0.999 * (total - 2.0 * negligible)) return false;
  double common = 0.0;
  for (const Triangle2d& cover : covers) common += std::max(0.0, PolygonArea(ClipByTriangle(pieces[0], cover)));
  if (common < total - 2.0 * negligible) return false;
  for (const Triangle2d& cover : covers) {
    if (!Spend(pieces.size(), budget)) return false;
    rest.clear();
    for (Polygon2d& piece : pieces) {
      for (size_t i = 0; i < 3; ++i) {
        Polygon2d outside = ClipPolygon(piece, cover[i], cover[(i + 1) % 3], /*keep_left=*/false);
        if (PolygonArea(outside) > 1e-3 * negligible) rest.push_back(std::move(outside));
        piece = ClipPolygon(piece, cover[i], cover[(i + 1) % 3], /*keep_left=*/true);
      }
    }
    pieces.swap(rest);
  }
  double remaining = 0.0;
  for (const Polygon2d& piece : pieces) remaining += PolygonArea(piece);
  return remaining <= negligible;
}

class OverlapRemover {
 public:
  OverlapRemover(double tolerance_m, absl::Span<const uint32_t> shell_of, RawMesh& mesh)
      : tolerance_m_(tolerance_m), shell_of_(shell_of), mesh_(mesh), normals_(mesh.triangles.size()) {
    for (size_t t = 0; t < normals_.size(); ++t) {
      const auto& [i, j, k] = mesh.triangles[t];
      normals_[t] = (mesh.points[j] - mesh.points[i]).cross(mesh.points[k] - mesh.points[i]).normalized();
    }
  }

  OverlapReport Remove() {
    FindPairs();
    if (pairs_.empty()) return report_;
    MarkCovered();
    uses_ = SortedEdgeUses(mesh_.triangles);
    std::vector<bool> remove(mesh_.triangles.size(), false);
    AddPatches(is_copy_, remove);
    AddRemovableWalls(remove);
    AddPatches(is_second_, remove);  // copies with the other winding
    report_.removed_triangles = RemoveTriangles(remove, mesh_);
    if (report_.removed_triangles == 0) FindCoveredEdges();
    return report_;
  }

 private:
  // The triangles of the largest shell are only searched for, which halves the work for a body with small parts.
  uint32_t LargestShell() const {
    std::vector<size_t> sizes(*std::max_element(shell_of_.begin(), shell_of_.end()) + 1);
    for (const uint32_t shell : shell_of_) ++sizes[shell];
    return static_cast<uint32_t>(std::max_element(sizes.begin(), sizes.end()) - sizes.begin());
  }

  Eigen::AlignedBox3f BoxOf(uint32_t t) const {
    Eigen::AlignedBox3d box;
    for (const uint32_t vertex : mesh_.triangles[t]) box.extend(mesh_.points[vertex]);
    return box.cast<float>();
  }

  // Returns the boxes of all shells but the largest; these shells become `other_shells_`.
  std::vector<Eigen::AlignedBox3f> BoxesOfOtherShells(uint32_t largest) {
    std::vector<Eigen::AlignedBox3f> boxes(*std::max_element(shell_of_.begin(), shell_of_.end()) + 1);
    for (uint32_t t = 0; t < mesh_.triangles.size(); ++t) boxes[shell_of_[t]].extend(BoxOf(t));
    other_shells_.resize(boxes.size());
    std::iota(other_shells_.begin(), other_shells_.end(), 0u);
    boxes.erase(boxes.begin() + largest);
    other_shells_.erase(other_shells_.begin() + largest);
    return boxes;
  }

  // Lists both orders of each pair of triangles of different shells that overlap, sorted.
  void FindPairs() {
    const uint32_t largest = LargestShell();
    std::vector<uint32_t> others;
    std::vector<Eigen::AlignedBox3f> boxes;
    for (uint32_t t = 0; t < mesh_.triangles.size(); ++t) {
      if (shell_of_[t] == largest) continue;
      others.push_back(t);
      boxes.push_back(BoxOf(t));
    }
    const BoxTree tree(boxes), shells(BoxesOfOtherShells(largest));
    size_t budget = std::min(kOverlapNodesPerSearch * mesh_.triangles.size(),
                             kOverlapNodesForAnySize + kOverlapNodesPerLateSearch * mesh_.triangles.size());
    const size_t max_pairs = 2 * kOverlapsPerTriangle * mesh_.triangles.size();
    for (uint32_t t = 0; t < mesh_.triangles.size(); ++t) {
      YieldPoint(t);
      Eigen::AlignedBox3f query = BoxOf(t);
      // The tolerance is at least eight roundings of a coordinate to float.
      const Eigen::Vector3f margin = Eigen::Vector3f::Constant(static_cast<float>(2.0 * tolerance_m_));
      query = Eigen::AlignedBox3f(query.min() - margin, query.max() + margin);
      // The triangles of a shell of its own would be found but not needed: those of a fan are all near to each other.
      if (shell_of_[t] != largest) {
        bool meets_other = false;
        report_.is_complete &=
            shells.VisitMeeting(query, budget, [&](uint32_t i) { meets_other |= other_shells_[i] != shell_of_[t]; });
        if (!meets_other) continue;
      }
      const bool was_complete = tree.VisitMeeting(query, budget, [&](uint32_t i) {
        const uint32_t other = others[i];
        // A pair of two triangles of the tree is found from both.
        const bool is_second = shell_of_[t] != largest && other <= t;
        if (shell_of_[t] == shell_of_[other] || is_second) return;
        budget -= std::min(budget, kNodesPerComparison);
        if (!Overlap(t, other)) return;
        if (pairs_.size() >= max_pairs) {
          report_.is_complete = false;
          return;
        }
        pairs_.push_back({t, other});
        pairs_.push_back({other, t});
      });
      report_.is_complete &= was_complete;
    }
    std::sort(pairs_.begin(), pairs_.end());
  }

  // Whether the corners of `a` are near the plane of `b`.
  bool IsInPlaneOf(uint32_t a, uint32_t b) const {
    const Eigen::Vector3d& corner = mesh_.points[mesh_.triangles[b][0]];
    return std::all_of(mesh_.triangles[a].begin(), mesh_.triangles[a].end(), [&](uint32_t vertex) {
      return std::abs(normals_[b].dot(mesh_.points[vertex] - corner)) <= tolerance_m_;
    });
  }

  bool Overlap(uint32_t a, uint32_t b) const {
    if (std::abs(normals_[a].dot(normals_[b])) < kSamePlaneCosine) return false;
    if (!IsInPlaneOf(a, b) && !IsInPlaneOf(b, a)) return false;
    const Triangle2d in_a = Project(a, a), other = Project(b, a);
    return !SeparatesBySide(in_a, other, tolerance_m_) && !SeparatesBySide(other, in_a, tolerance_m_);
  }

  // A triangle in coordinates in the plane of another, counter-clockwise there.
  Triangle2d Project(uint32_t triangle, uint32_t plane) const {
    const Eigen::Vector3d& origin = mesh_.points[mesh_.triangles[plane][0]];
    const Eigen::Vector3d u = (mesh_.points[mesh_.triangles[plane][1]] - origin).normalized();
    const Eigen::Vector3d v = normals_[plane].cross(u);
    Triangle2d projected;
    for (size_t i = 0; i < 3; ++i) {
      const Eigen::Vector3d relative = mesh_.points[mesh_.triangles[triangle][i]] - origin;
      projected[i] = {u.dot(relative), v.dot(relative)};
    }
    if (normals_[triangle].dot(normals_[plane]) < 0.0) std::swap(projected[1], projected[2]);
    return projected;
  }

  // Goes from the last triangle to the first, so that the first of two copies remains.
  void MarkCovered() {
    is_copy_.assign(mesh_.triangles.size(), false);
    is_wall_.assign(mesh_.triangles.size(), false);
    is_second_.assign(mesh_.triangles.size(), false);
    std::vector<Triangle2d> same, opposite, first_opposite;
    size_t budget = kCutsPerTriangle * mesh_.triangles.size() + kCutsForAnySize;
    for (size_t end = pairs_.size(); end > 0;) {
      const uint32_t t = pairs_[end - 1].first;
      same.clear();
      opposite.clear();
      first_opposite.clear();
      for (; end > 0 && pairs_[end - 1].first == t; --end) {
        const uint32_t other = pairs_[end - 1].second;
        if (normals_[t].dot(normals_[other]) < 0.0) {
          opposite.push_back(Project(other, t));
          if (!is_second_[other]) first_opposite.push_back(opposite.back());
        } else if (!is_copy_[other]) {
          same.push_back(Project(other, t));
        }
      }
      const Triangle2d triangle = Project(t, t);
      is_copy_[t] = AreCovering(same, triangle, tolerance_m_, budget);
      is_wall_[t] = AreCovering(opposite, triangle, tolerance_m_, budget);
      is_second_[t] = is_wall_[t] && (first_opposite.size() == opposite.size() ||
                                      AreCovering(first_opposite, triangle, tolerance_m_, budget));
    }
    report_.is_complete &= budget > 0;
  }

  // Adds to `remove` each patch of marked triangles that leaves an even number of faces at all of its edges when it is
  // removed. Without any other patch, a body would have a hole, a sheet only one side, or a wall an end within a body.
  void AddPatches(const std::vector<bool>& marked, std::vector<bool>& remove) const {
    DisjointSets patches(marked.size());
    std::vector<uint32_t> beside;  // marked triangles at an edge that has to keep them
    ForEachEdge(uses_, [&](absl::Span<const EdgeUse> uses) {
      const MarkedAtEdge at_edge = JoinMarked(uses, marked, remove, patches);
      if (at_edge.first != nullptr && at_edge.rest % 2 != 0) beside.push_back(at_edge.first->triangle);
    });
    std::vector<bool> must_stay(marked.size(), false);
    for (const uint32_t t : beside) must_stay[patches.Find(t)] = true;
    for (uint32_t t = 0; t < marked.size(); ++t) {
      if (marked[t] && !must_stay[patches.Find(t)]) remove[t] = true;
    }
  }

  // Adds the walls of connected bodies that are closed without them. A sheet with two sides consists of such walls
  // nearly alone, or ends in an edge that no other triangle has. Nearly, because the walls of narrow triangles are not
  // found.
  void AddRemovableWalls(std::vector<bool>& remove) const {
    DisjointSets bodies(mesh_.triangles.size());
    std::vector<uint32_t> open;
    ForEachEdge(uses_, [&](absl::Span<const EdgeUse> uses) {
      const EdgeUse* first = nullptr;
      size_t rest = 0;
      for (const EdgeUse& use : uses) {
        if (remove[use.triangle]) continue;
        if (first == nullptr) first = &use;
        bodies.Join(first->triangle, use.triangle);
        if (!is_wall_[use.triangle]) ++rest;
      }
      if (first == nullptr) return;
      if (rest % 2 != 0 || (rest == 0 && AreOnOneSide(uses))) open.push_back(first->triangle);
    });
    // What remains encloses the walls: its area is at least that of one of the two sides of each.
    std::vector<double> excess_m2(mesh_.triangles.size(), 0.0);
    for (uint32_t t = 0; t < remove.size(); ++t) {
      if (!remove[t]) excess_m2[bodies.Find(t)] += (is_wall_[t] ? -0.5 : 1.0) * TriangleArea(mesh_, t);
    }
    std::vector<bool> must_stay(mesh_.triangles.size());
    for (uint32_t body = 0; body < must_stay.size(); ++body) must_stay[body] = !(excess_m2[body] > 0.0);
    for (const uint32_t t : open) must_stay[bodies.Find(t)] = true;
    for (uint32_t t = 0; t < remove.size(); ++t) {
      if (is_wall_[t] && !must_stay[bodies.Find(t)]) remove[t] = true;
    }
  }

  void FindCoveredEdges() {
    std::vector<Triangle2d> same;
    for (size_t begin = 0; begin < pairs_.size();) {
      const uint32_t t = pairs_[begin].first;
      same.clear();
      for (; begin < pairs_.size() && pairs_[begin].first == t; ++begin) {
        const uint32_t other = pairs_[begin].second;
        if (normals_[t].dot(normals_[other]) > 0.0) same.push_back(Project(other, t));
      }
      for (size_t side = 0; side < 3; ++side) {
        const uint32_t from = mesh_.triangles[t][side], to = mesh_.triangles[t][(side + 1) % 3];
        if (!ContinuesAcross(t, side, same) || HasFaceAbove(t, from, to)) continue;
        report_.covered_edges.push_back({std::min(from, to), std::max(from, to)});
      }
    }
    std::vector<std::array<uint32_t, 2>>& edges = report_.covered_edges;
    std::sort(edges.begin(), edges.end());
    edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  }

  // Whether triangles contain points just beyond a side of another, in its plane.
  bool ContinuesAcross(uint32_t t, size_t side, const std::vector<Triangle2d>& others) const {
    // Near both ends and between them, so that a triangle which continues a part of the side does not count; and so far
    // beyond the side that the errors of the corners do not matter.
    constexpr double kSamples[] = {0.02, 0.3, 0.5, 0.7, 0.98};  // shares of the side
    constexpr double kOffset = 4.0;                             // tolerances
    const Triangle2d triangle = Project(t, t);
    const Eigen::Vector2d &a = triangle[side], &b = triangle[(side + 1) % 3];
    const Eigen::Vector2d outward = Eigen::Vector2d((b - a).y(), (a - b).x()).normalized();
    return std::all_of(std::begin(kSamples), std::end(kSamples), [&](double sample) {
      const Eigen::Vector2d point = a + sample * (b - a) + kOffset * tolerance_m_ * outward;
      return std::any_of(others.begin(), others.end(), [&](const Triangle2d& other) {
        return DistanceToLeft(other[0], other[1], point) >= -tolerance_m_ &&
               DistanceToLeft(other[1], other[2], point) >= -tolerance_m_ &&
               DistanceToLeft(other[2], other[0], point) >= -tolerance_m_;
      });
    });
  }

  // Whether a face at an edge of a triangle extends to its outer side, as the side of a body that stands on it.
  bool HasFaceAbove(uint32_t t, uint32_t from, uint32_t to) const {
    const absl::Span<const EdgeUse> uses = UsesOfEdge(uses_, std::min(from, to), std::max(from, to));
    return std::any_of(uses.begin(), uses.end(), [&](const EdgeUse& use) {
      const uint32_t opposite = mesh_.triangles[use.triangle][(use.side + 2) % 3];
      return normals_[t].dot(mesh_.points[opposite] - mesh_.points[from]) > tolerance_m_;
    });
  }

  // Whether the triangles at an edge are in one plane and extend to the same side, as at the end of a sheet.
  bool AreOnOneSide(absl::Span<const EdgeUse> uses) const {
    const Eigen::Vector3d& low = mesh_.points[uses[0].low];
    const Eigen::Vector3d& normal = normals_[uses[0].triangle];
    const Eigen::Vector3d left = normal.cross(mesh_.points[uses[0].high] - low);
    const auto is_left = [&](const EdgeUse& use) {
      return left.dot(mesh_.points[mesh_.triangles[use.triangle][(use.side + 2) % 3]] - low) > 0.0;
    };
    return std::all_of(uses.begin(), uses.end(), [&](const EdgeUse& use) {
      return std::abs(normal.dot(normals_[use.triangle])) >= kSamePlaneCosine && is_left(use) == is_left(uses[0]);
    });
  }

  const double tolerance_m_;
  const absl::Span<const uint32_t> shell_of_;
  RawMesh& mesh_;
  std::vector<Eigen::Vector3d> normals_;  // normals of the triangles, unit
  std::vector<uint32_t> other_shells_;
  std::vector<std::pair<uint32_t, uint32_t>> pairs_;
  std::vector<bool> is_copy_;    // covered by triangles with the same winding that are not copies
  std::vector<bool> is_wall_;    // covered by triangles with the opposite winding
  std::vector<bool> is_second_;  // covered by those of them that are not second
  std::vector<EdgeUse> uses_;
  OverlapReport report_;
};

}  // namespace

OverlapReport RemoveOverlaps(double tolerance_m, absl::Span<const uint32_t> shell_of, RawMesh& mesh) {
  return OverlapRemover(tolerance_m, shell_of, mesh).Remove();
}

}  // namespace evpose
