// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/facet_graph.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/types/span.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// A path of four hundredths of the diameter crosses some 40 triangles of a regular mesh of a million.
constexpr int kMaxSteps = 96;
// Where two bodies touch, each has a face there: both with the same direction from the edge (8 degrees, because the
// normals of narrow triangles are inaccurate), and behind the faces that are seen by at least 3 degrees.
constexpr double kSameWingCosine = 0.99, kInsideSine = 0.05;
// Faces at an edge where some bodies touch; more are not compared.
constexpr size_t kMaxUsesOfJoint = 8;

// The side at which a path leaves a triangle that it has entered at `entry`, and the distance to it; kNone if rounding
// errors leave no such side.
std::pair<uint32_t, double> ExitOf(const FacetGraph& graph, uint32_t entry, const Eigen::Vector3d& point,
                                   const Eigen::Vector3d& direction) {
  constexpr double kParallel = 1e-12;  // rounding error of a direction along the side
  uint32_t exit = FacetGraph::kNone;
  double distance_m = 0.0;
  for (uint32_t offset = 1; offset < 3; ++offset) {
    const uint32_t side = entry / 3 * 3 + (entry + offset) % 3;
    const Eigen::Vector3d into = graph.Into(side);
    const double rate = -direction.dot(into);
    if (rate < kParallel) continue;
    const double here_m = std::max(0.0, (point - graph.begin(side)).dot(into)) / rate;
    if (exit != FacetGraph::kNone && here_m >= distance_m) continue;
    exit = side;
    distance_m = here_m;
  }
  return {exit, distance_m};
}

}  // namespace

Eigen::Vector3d WingOf(const RawMesh& mesh, const EdgeUse& use) {
  const Eigen::Vector3d edge = (mesh.points[use.high] - mesh.points[use.low]).normalized();
  const Eigen::Vector3d across = mesh.points[mesh.triangles[use.triangle][(use.side + 2) % 3]] - mesh.points[use.low];
  return (across - across.dot(edge) * edge).normalized();
}

double AngleBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return DeterministicAtan2(a.cross(b).norm(), a.dot(b));
}

FacetGraph::FacetGraph(const RawMesh& mesh)
    : mesh_(mesh),
      uses_(SortedEdgeUses(mesh.triangles)),
      opposite_(3 * mesh.triangles.size(), kNone),
      turn_rad_(3 * mesh.triangles.size(), 0.0f) {
  normals_.reserve(mesh.triangles.size());
  for (const auto& [i, j, k] : mesh.triangles) {
    normals_.push_back((mesh.points[j] - mesh.points[i]).cross(mesh.points[k] - mesh.points[i]).normalized());
  }
  ForEachEdge(uses_, [this](absl::Span<const EdgeUse> uses) {
    for (const std::array<EdgeUse, 2>& pair : NeighboursAt(uses)) SetNeighbours(pair);
  });
}

void FacetGraph::SetNeighbours(const std::array<EdgeUse, 2>& pair) {
  const uint32_t first = 3 * pair[0].triangle + pair[0].side, second = 3 * pair[1].triangle + pair[1].side;
  opposite_[first] = second;
  opposite_[second] = first;
  const Eigen::Vector3d &n1 = normals_[first / 3], &n2 = normals_[second / 3];
  const double angle = AngleBetween(n1, n2);
  const bool is_convex = n1.cross(n2).dot(end(first) - begin(first)) >= 0.0;
  turn_rad_[first] = turn_rad_[second] = static_cast<float>(is_convex ? angle : -angle);
}

absl::InlinedVector<std::array<EdgeUse, 2>, 2> FacetGraph::NeighboursAt(absl::Span<const EdgeUse> uses) const {
  if (uses.size() == 2 && uses[0].is_forward != uses[1].is_forward) return {{uses[0], uses[1]}};
  if (uses.size() <= 2 || uses.size() > kMaxUsesOfJoint) return {};
  std::vector<EdgeUse> rest(uses.begin(), uses.end());
  std::vector<std::array<EdgeUse, 2>> walls;  // with one wing
  for (size_t i = 0; rest.size() > 2 && i < rest.size();) {
    const Eigen::Vector3d wing = WingOf(mesh_, rest[i]);
    const auto other =
        std::find_if(rest.begin() + static_cast<std::ptrdiff_t>(i) + 1, rest.end(), [&](const EdgeUse& use) {
          return use.is_forward != rest[i].is_forward && WingOf(mesh_, use).dot(wing) > kSameWingCosine;
        });
    if (other == rest.end()) {
      ++i;
      continue;
    }
    walls.push_back({rest[i], *other});
    rest.erase(other);
    rest.erase(rest.begin() + static_cast<std::ptrdiff_t>(i));
  }
  if (rest.size() != 2 || rest[0].is_forward == rest[1].is_forward) return {};
  // Two walls are a sheet with two sides: each of its triangles has its neighbour in the other wall, on its own side.
  if (walls.size() == 1 && WingOf(mesh_, rest[0]).dot(WingOf(mesh_, rest[1])) > kSameWingCosine) {
    const bool is_first = rest[0].is_forward != walls[0][0].is_forward;
    return {{walls[0][0], rest[is_first ? 0 : 1]}, {walls[0][1], rest[is_first ? 1 : 0]}};
  }
  const Eigen::Vector3d &n1 = normals_[rest[0].triangle], &n2 = normals_[rest[1].triangle];
  const bool is_convex = n1.dot(WingOf(mesh_, rest[1])) <= 0.0;
  for (const auto& [wall_use, other_use] : walls) {
    const Eigen::Vector3d wall = WingOf(mesh_, wall_use);
    const bool is_behind1 = n1.dot(wall) < -kInsideSine, is_behind2 = n2.dot(wall) < -kInsideSine;
    if (is_convex ? !is_behind1 || !is_behind2 : !is_behind1 && !is_behind2) return {};
  }
  return {{rest[0], rest[1]}};
}

void WalkAcross(const FacetGraph& graph, uint32_t side, double max_length_m, int64_t& work,
                absl::FunctionRef<bool(const PathStep& step)> visit) {
  Eigen::Vector3d point = 0.5 * (graph.begin(side) + graph.end(side));
  Eigen::Vector3d direction = graph.Into(side);
  double length_m = 0.0;
  for (int i = 0; i < kMaxSteps && length_m < max_length_m && work > 0; ++i) {
    --work;
    const auto [exit, distance_m] = ExitOf(graph, side, point, direction);
    if (exit == FacetGraph::kNone || !visit({side / 3, length_m, length_m + distance_m, exit})) return;
    const uint32_t next = graph.opposite(exit);
    if (next == FacetGraph::kNone) return;
    point += distance_m * direction;
    length_m += distance_m;
    const Eigen::Vector3d along = graph.Along(exit);
    const double cosine = direction.dot(along);
    direction = cosine * along + std::sqrt(std::max(0.0, 1.0 - cosine * cosine)) * graph.Into(next);
    side = next;
  }
}

}  // namespace evpose
