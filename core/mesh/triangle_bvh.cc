// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/triangle_bvh.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/base/yield_point.h"

namespace evpose {
namespace {

// A usual compromise: smaller leaves need more boxes, larger ones more tests of triangles.
constexpr uint32_t kMaxLeafTriangles = 4;
// Halving 2^32 triangles gives 32 levels, and the stack has at most one sibling of each.
constexpr int kMaxDepth = 40;

// Whether the segment origin + t direction, 0 <= t <= 1, meets the box.
bool MeetsBox(const Eigen::AlignedBox3d& box, const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
              const Eigen::Vector3d& inverse_direction) {
  double begin = 0.0, end = 1.0;
  for (int axis = 0; axis < 3; ++axis) {
    if (direction[axis] == 0.0) {
      if (origin[axis] < box.min()[axis] || origin[axis] > box.max()[axis]) return false;
      continue;
    }
    const double t1 = (box.min()[axis] - origin[axis]) * inverse_direction[axis];
    const double t2 = (box.max()[axis] - origin[axis]) * inverse_direction[axis];
    begin = std::max(begin, std::min(t1, t2));
    end = std::min(end, std::max(t1, t2));
  }
  return begin <= end;
}

double SquaredDistanceToSegment(const Eigen::Vector3d& point, const Eigen::Vector3d& a, const Eigen::Vector3d& edge) {
  const double t = std::clamp((point - a).dot(edge) / edge.squaredNorm(), 0.0, 1.0);
  return (point - a - t * edge).squaredNorm();
}

}  // namespace

TriangleBvh::TriangleBvh(absl::Span<const Eigen::Vector3d> vertices,
                         absl::Span<const std::array<uint32_t, 3>> triangles) {
  if (triangles.empty()) return;
  std::vector<uint32_t> order(triangles.size());
  std::iota(order.begin(), order.end(), 0u);
  triangles_.reserve(triangles.size());
  Build({vertices, triangles}, absl::MakeSpan(order));
}

void TriangleBvh::Build(const Mesh& mesh, absl::Span<uint32_t> triangles) {
  const size_t node = nodes_.size();
  nodes_.emplace_back();
  Eigen::AlignedBox3d box, centres;
  for (const uint32_t triangle : triangles) {
    const auto& [i, j, k] = mesh.triangles[triangle];
    box.extend(mesh.vertices[i]).extend(mesh.vertices[j]).extend(mesh.vertices[k]);
    centres.extend(mesh.vertices[i] + mesh.vertices[j] + mesh.vertices[k]);
  }
  nodes_[node].box = box;
  if (triangles.size() <= kMaxLeafTriangles) {
    nodes_[node].first = static_cast<uint32_t>(triangles_.size());
    nodes_[node].count = static_cast<uint32_t>(triangles.size());
    for (const uint32_t triangle : triangles) {
      const auto& [i, j, k] = mesh.triangles[triangle];
      const Eigen::Vector3d edge1 = mesh.vertices[j] - mesh.vertices[i], edge2 = mesh.vertices[k] - mesh.vertices[i];
      triangles_.push_back({mesh.vertices[i], edge1, edge2, edge1.cross(edge2).normalized()});
    }
    return;
  }
  int axis;
  centres.sizes().maxCoeff(&axis);
  const auto centre = [&](uint32_t triangle) {
    const auto& [i, j, k] = mesh.triangles[triangle];
    return mesh.vertices[i][axis] + mesh.vertices[j][axis] + mesh.vertices[k][axis];
  };
  const size_t half = triangles.size() / 2;
  // Ties are broken by index, so that the tree is a function of the mesh.
  std::nth_element(triangles.begin(), triangles.begin() + half, triangles.end(), [&](uint32_t a, uint32_t b) {
    const double centre_a = centre(a), centre_b = centre(b);
    return centre_a != centre_b ? centre_a < centre_b : a < b;
  });
  Build(mesh, triangles.subspan(0, half));
  nodes_[node].first = static_cast<uint32_t>(nodes_.size());
  Build(mesh, triangles.subspan(half));
}

bool TriangleBvh::IsOccluded(const Eigen::Vector3d& origin, const Eigen::Vector3d& point,
                             double plane_tolerance_m) const {
  if (nodes_.empty()) return false;
  const Eigen::Vector3d direction = point - origin;
  const Eigen::Vector3d inverse_direction = direction.cwiseInverse();
  const auto occludes = [&](const Triangle& triangle) {
    const double point_height = triangle.normal.dot(point - triangle.corner);
    if (std::abs(point_height) <= plane_tolerance_m) return false;
    const double origin_height = triangle.normal.dot(origin - triangle.corner);
    if ((point_height > 0.0) == (origin_height > 0.0)) return false;
    const Eigen::Vector3d p = direction.cross(triangle.edge2);
    const double determinant = triangle.edge1.dot(p);
    const Eigen::Vector3d s = origin - triangle.corner;
    const double u = s.dot(p) / determinant;
    const double v = direction.dot(s.cross(triangle.edge1)) / determinant;
    return u >= 0.0 && v >= 0.0 && u + v <= 1.0;
  };
  std::array<uint32_t, kMaxDepth> waiting;
  int waiting_count = 0;
  uint32_t current = 0;
  for (size_t visited = 0;; ++visited) {
    YieldPoint(visited);
    const Node& node = nodes_[current];
    if (MeetsBox(node.box, origin, direction, inverse_direction)) {
      for (uint32_t i = 0; i < node.count; ++i) {
        if (occludes(triangles_[node.first + i])) return true;
      }
      if (node.count == 0) {
        waiting[waiting_count++] = node.first;
        ++current;
        continue;
      }
    }
    if (waiting_count == 0) return false;
    current = waiting[--waiting_count];
  }
}

template <typename Visit>
void TriangleBvh::VisitNear(const Eigen::Vector3d& point, double radius_m, const Visit& visit) const {
  if (nodes_.empty()) return;
  const auto squared_distance = [&point](const Triangle& t) {
    const Eigen::Vector3d s = point - t.corner;
    const double area = t.edge1.cross(t.edge2).dot(t.normal);
    const double u = s.cross(t.edge2).dot(t.normal) / area;
    const double v = t.edge1.cross(s).dot(t.normal) / area;
    if (u >= 0.0 && v >= 0.0 && u + v <= 1.0) return s.dot(t.normal) * s.dot(t.normal);
    return std::min({SquaredDistanceToSegment(point, t.corner, t.edge1),
                     SquaredDistanceToSegment(point, t.corner, t.edge2),
                     SquaredDistanceToSegment(point, t.corner + t.edge1, t.edge2 - t.edge1)});
  };
  std::array<uint32_t, kMaxDepth> waiting;
  int waiting_count = 0;
  uint32_t current = 0;
  while (true) {
    const Node& node = nodes_[current];
    if (node.box.squaredExteriorDistance(point) <= radius_m * radius_m) {
      for (uint32_t i = 0; i < node.count; ++i) {
        const Triangle& triangle = triangles_[node.first + i];
        const double distance2 = squared_distance(triangle);
        if (distance2 <= radius_m * radius_m && visit(triangle, distance2)) return;
      }
      if (node.count == 0) {
        waiting[waiting_count++] = node.first;
        ++current;
        continue;
      }
    }
    if (waiting_count == 0) return;
    current = waiting[--waiting_count];
  }
}

void TriangleBvh::FindNear(const Eigen::Vector3d& point, double radius_m, std::vector<Near>& found) const {
  found.clear();
  VisitNear(point, radius_m, [&found](const Triangle& triangle, double distance2) {
    found.push_back({std::sqrt(distance2), triangle.normal});
    return false;
  });
}

bool TriangleBvh::HasNear(const Eigen::Vector3d& point, double radius_m, const Eigen::Vector3d& direction,
                          double min_cosine) const {
  bool has_near = false;
  VisitNear(point, radius_m, [&](const Triangle& triangle, double) {
    has_near = triangle.normal.dot(direction) >= min_cosine;
    return has_near;
  });
  return has_near;
}

}  // namespace evpose
