// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/inner_shells.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "core/base/yield_point.h"
#include "core/mesh/box_tree.h"
#include "core/mesh/mesh_edges.h"
#include "core/mesh/mesh_topology.h"

namespace evpose {
namespace {

// An assembly has few housings. More closed shells could each be compared with each other.
constexpr size_t kMaxHousings = 64;
// Nodes of search trees that all searches may visit: for any mesh, and for each triangle. A comparison of two triangles
// counts as some nodes.
constexpr size_t kHousingNodes = 2'000'000, kHousingNodesPerTriangle = 100, kNodesPerPair = 4;
// Points of a shell that must all be inside the other one, in case that rounding errors affect one of them.
constexpr size_t kInsideSamples = 3;

using TrianglePoints = std::array<Eigen::Vector3d, 3>;

TrianglePoints PointsOf(const RawMesh& mesh, uint32_t triangle) {
  const auto& [i, j, k] = mesh.triangles[triangle];
  return {mesh.points[i], mesh.points[j], mesh.points[k]};
}

// Whether the projections of the triangles to the axis are farther apart than the tolerance.
bool AreApartAlong(const Eigen::Vector3d& axis, const TrianglePoints& a, const TrianglePoints& b, double tolerance_m) {
  const double length = axis.norm();
  if (!(length > 0.0)) return false;
  const auto [low_a, high_a] = std::minmax({axis.dot(a[0]), axis.dot(a[1]), axis.dot(a[2])});
  const auto [low_b, high_b] = std::minmax({axis.dot(b[0]), axis.dot(b[1]), axis.dot(b[2])});
  return std::max(low_b - high_a, low_a - high_b) > tolerance_m * length;
}

// Two convex polygons that are apart are so along a normal of one of them, the cross product of an edge of each, or, in
// one plane, the normal of an edge within that plane.
bool AreApart(const TrianglePoints& a, const TrianglePoints& b, double tolerance_m) {
  const auto edge = [](const TrianglePoints& t, size_t i) -> Eigen::Vector3d { return t[(i + 1) % 3] - t[i]; };
  const Eigen::Vector3d normal_a = edge(a, 0).cross(edge(a, 1)), normal_b = edge(b, 0).cross(edge(b, 1));
  if (AreApartAlong(normal_a, a, b, tolerance_m) || AreApartAlong(normal_b, a, b, tolerance_m)) return true;
  for (size_t i = 0; i < 3; ++i) {
    if (AreApartAlong(normal_a.cross(edge(a, i)), a, b, tolerance_m)) return true;
    if (AreApartAlong(normal_b.cross(edge(b, i)), a, b, tolerance_m)) return true;
    for (size_t k = 0; k < 3; ++k) {
      if (AreApartAlong(edge(a, i).cross(edge(b, k)), a, b, tolerance_m)) return true;
    }
  }
  return false;
}

// The side of the directed line from `a` to `b`, in the projection along x, on which `point` is. A point on the line is
// shifted by an infinitesimal distance along y, and by a smaller one along z, so that a line through a mesh meets each
// surface in a triangle.
bool IsLeftInYz(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& point) {
  const Eigen::Vector3d along = b - a, to = point - a;
  const double cross = along.y() * to.z() - along.z() * to.y();
  if (cross != 0.0) return cross > 0.0;
  return along.z() != 0.0 ? along.z() < 0.0 : along.y() > 0.0;
}

// A closed shell and a search tree of its triangles.
class Housing {
 public:
  Housing(const RawMesh& mesh, std::vector<uint32_t> triangles, const Eigen::AlignedBox3d& box, double tolerance_m)
      : mesh_(mesh), triangles_(std::move(triangles)), box_(box), tolerance_m_(tolerance_m), tree_(Boxes()) {}

  // Whether no triangle of the other shell is within the tolerance of this one, and the shell is inside. False if the
  // budget ends.
  bool Encloses(absl::Span<const uint32_t> shell, size_t& budget) const {
    const size_t step = std::max<size_t>(1, shell.size() / kInsideSamples);
    for (size_t i = 0; i < shell.size(); i += step) {
      YieldPoint();
      const TrianglePoints points = PointsOf(mesh_, shell[i]);
      if (!IsInside((points[0] + points[1] + points[2]) / 3.0, budget)) return false;
    }
    for (size_t i = 0; i < shell.size(); ++i) {
      YieldPoint(i);
      if (!IsApartFrom(PointsOf(mesh_, shell[i]), budget)) return false;
    }
    return true;
  }

 private:
  Eigen::AlignedBox3f Inflated(const Eigen::AlignedBox3d& box) const {
    const Eigen::Vector3d margin = Eigen::Vector3d::Constant(tolerance_m_);
    return {(box.min() - margin).cast<float>(), (box.max() + margin).cast<float>()};
  }

  std::vector<Eigen::AlignedBox3f> Boxes() const {
    std::vector<Eigen::AlignedBox3f> boxes;
    for (const uint32_t t : triangles_) {
      Eigen::AlignedBox3d box;
      for (const Eigen::Vector3d& point : PointsOf(mesh_, t)) box.extend(point);
      boxes.push_back(Inflated(box));
    }
    return boxes;
  }

  // Counts how often a line from the point in the direction of x meets the shell.
  bool IsInside(const Eigen::Vector3d& point, size_t& budget) const {
    Eigen::AlignedBox3d line(point);
    line.extend(Eigen::Vector3d(box_.max().x(), point.y(), point.z()));
    bool is_inside = false;
    const bool is_complete = tree_.VisitMeeting(Inflated(line), budget, [&](uint32_t index) {
      is_inside ^= IsMetFrom(point, mesh_.triangles[triangles_[index]]);
    });
    return is_complete && is_inside;
  }

  bool IsMetFrom(const Eigen::Vector3d& point, const std::array<uint32_t, 3>& corners) const {
    std::array<bool, 3> is_left;
    for (size_t i = 0; i < 3; ++i) {
      // Both triangles at an edge evaluate it from its lower to its higher vertex, with the same roundings.
      const auto [low, high] = std::minmax(corners[i], corners[(i + 1) % 3]);
      is_left[i] = IsLeftInYz(mesh_.points[low], mesh_.points[high], point) == (low == corners[i]);
    }
    if (is_left[0] != is_left[1] || is_left[1] != is_left[2]) return false;
    const Eigen::Vector3d& a = mesh_.points[corners[0]];
    const Eigen::Vector3d normal = (mesh_.points[corners[1]] - a).cross(mesh_.points[corners[2]] - a);
    return normal.x() != 0.0 && normal.dot(a - point) / normal.x() > 0.0;
  }

  bool IsApartFrom(const TrianglePoints& triangle, size_t& budget) const {
    Eigen::AlignedBox3d box;
    for (const Eigen::Vector3d& point : triangle) box.extend(point);
    bool is_apart = true;
    size_t pairs = 0;
    const bool is_complete = tree_.VisitMeeting(Inflated(box), budget, [&](uint32_t index) {
      ++pairs;
      is_apart = is_apart && AreApart(triangle, PointsOf(mesh_, triangles_[index]), tolerance_m_);
    });
    budget -= std::min(budget, kNodesPerPair * pairs);
    return is_complete && is_apart;
  }

  const RawMesh& mesh_;
  const std::vector<uint32_t> triangles_;
  const Eigen::AlignedBox3d box_;
  const double tolerance_m_;
  const BoxTree tree_;
};

// Whether each shell passes each of its edges as often in one direction as in the other.
std::vector<bool> FindClosedShells(const RawMesh& mesh, absl::Span<const uint32_t> shell_of, size_t num_shells) {
  std::vector<bool> is_closed(num_shells, true);
  std::map<uint32_t, int> sums;
  ForEachEdge(SortedEdgeUses(mesh.triangles), [&](absl::Span<const EdgeUse> uses) {
    sums.clear();
    for (const EdgeUse& use : uses) sums[shell_of[use.triangle]] += use.is_forward ? 1 : -1;
    for (const auto& [shell, sum] : sums) is_closed[shell] = is_closed[shell] && sum == 0;
  });
  return is_closed;
}

}  // namespace

InnerShells RemoveInnerShells(double tolerance_m, absl::Span<const uint32_t> shell_of, size_t num_shells,
                              RawMesh& mesh) {
  InnerShells removed;
  if (num_shells < 2) return removed;
  std::vector<std::vector<uint32_t>> shells(num_shells);
  std::vector<Eigen::AlignedBox3d> boxes(num_shells);
  for (uint32_t t = 0; t < shell_of.size(); ++t) {
    shells[shell_of[t]].push_back(t);
    for (const Eigen::Vector3d& point : PointsOf(mesh, t)) boxes[shell_of[t]].extend(point);
  }
  const std::vector<bool> is_closed = FindClosedShells(mesh, shell_of, num_shells);
  std::vector<uint32_t> housings;
  for (uint32_t shell = 0; shell < num_shells; ++shell) {
    if (is_closed[shell]) housings.push_back(shell);
  }
  std::stable_sort(housings.begin(), housings.end(),
                   [&boxes](uint32_t a, uint32_t b) { return boxes[a].volume() > boxes[b].volume(); });
  housings.resize(std::min(housings.size(), kMaxHousings));
  size_t budget = kHousingNodes + kHousingNodesPerTriangle * mesh.triangles.size();
  std::vector<bool> is_inner(num_shells, false);
  for (const uint32_t housing : housings) {
    if (is_inner[housing]) continue;
    std::optional<Housing> search;
    for (uint32_t shell = 0; shell < num_shells && budget > 0; ++shell) {
      YieldPoint(shell);
      if (shell == housing || is_inner[shell] || !boxes[housing].contains(boxes[shell])) continue;
      if (!search) search.emplace(mesh, shells[housing], boxes[housing], tolerance_m);
      is_inner[shell] = search->Encloses(shells[shell], budget);
    }
  }
  std::vector<bool> remove(mesh.triangles.size());
  for (uint32_t t = 0; t < remove.size(); ++t) remove[t] = is_inner[shell_of[t]];
  removed.shells = static_cast<size_t>(std::count(is_inner.begin(), is_inner.end(), true));
  if (removed.shells > 0) removed.triangles = RemoveTriangles(remove, mesh);
  return removed;
}

}  // namespace evpose
