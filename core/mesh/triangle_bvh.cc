// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/triangle_bvh.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

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

double SquaredDistanceToBounds(const Eigen::Vector3d& point, const std::array<std::array<float, 3>, 2>& bounds) {
  double distance2 = 0.0;
  for (int axis = 0; axis < 3; ++axis) {
    const double outside = std::max({bounds[0][axis] - point[axis], point[axis] - bounds[1][axis], 0.0});
    distance2 += outside * outside;
  }
  return distance2;
}

// The float next to `value` that is not above (below) it.
float RoundedDown(double value) {
  const auto rounded = static_cast<float>(value);
  return rounded > value ? std::nextafter(rounded, -std::numeric_limits<float>::infinity()) : rounded;
}
float RoundedUp(double value) { return -RoundedDown(-value); }

// Parameters of a ray that meets no box.
constexpr float kMissed = 2.0f;
// Smaller parts of a tree are built without a yield point: these take about 0.1 ms.
constexpr size_t kYieldTriangles = 1024;
// Slack of the comparison of two parameters in [0, 1], each with a relative error of at most 4 roundings to float.
constexpr float kParameterSlack = 1e-6f;
// Slack of a coordinate relative to its size: 4 roundings to float.
constexpr double kCoordinateSlack = 0x1p-22;
// A direction along which a segment moves less than this, m, has no extent along the axis.
constexpr float kLeastDirection = 1e-18f;

}  // namespace

// A segment in single precision. The slack that makes the boxes larger than the rounding errors is added to the origin:
// `origins[0]` is subtracted from least, `origins[1]` from greatest coordinates.
struct TriangleBvh::Ray {
  Ray(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction, double extent_m) {
    for (int axis = 0; axis < 3; ++axis) {
      const double slack = kCoordinateSlack * (std::abs(origin[axis]) + extent_m);
      origins[0][axis] = RoundedUp(origin[axis] + slack);
      origins[1][axis] = RoundedDown(origin[axis] - slack);
      const auto rounded = static_cast<float>(direction[axis]);
      const float component = std::abs(rounded) < kLeastDirection ? kLeastDirection : rounded;
      is_backward[axis] = component < 0.0f ? 1 : 0;
      inverse[axis] = 1.0f / component;
    }
  }

  // The parameter in [0, 1] at which the segment enters the box, or kMissed. A parameter that is not a number, of an
  // origin beyond the range of float, restricts nothing.
  float Enter(const Node& node) const {
    float begin = 0.0f, end = 1.0f;
    for (int axis = 0; axis < 3; ++axis) {
      const int near = is_backward[axis], far = 1 - near;
      begin = std::max(begin, (node.bounds[near][axis] - origins[near][axis]) * inverse[axis]);
      end = std::min(end, (node.bounds[far][axis] - origins[far][axis]) * inverse[axis]);
    }
    return begin <= end + kParameterSlack ? begin : kMissed;
  }

  std::array<std::array<float, 3>, 2> origins;
  std::array<float, 3> inverse;
  std::array<int, 3> is_backward;
};

TriangleBvh::TriangleBvh(absl::Span<const Eigen::Vector3d> vertices,
                         absl::Span<const std::array<uint32_t, 3>> triangles) {
  if (triangles.empty()) return;
  triangles_.reserve(triangles.size());
  // A leaf has at least two of five or more triangles, and there are twice as many nodes: 156 bytes for each triangle.
  leaves_.reserve(triangles.size() / 2 + 1);
  nodes_.reserve(triangles.size() + 1);
  Eigen::AlignedBox3d box;
  std::vector<Entry> order;
  order.reserve(triangles.size());
  for (const std::array<uint32_t, 3>& triangle : triangles) {
    for (const uint32_t corner : triangle) box.extend(vertices[corner]);
    order.push_back(
        {vertices[triangle[0]] + vertices[triangle[1]] + vertices[triangle[2]], static_cast<uint32_t>(order.size())});
  }
  centre_ = box.center();
  extent_m_ = 0.5 * box.sizes().maxCoeff();
  Build({vertices, triangles}, absl::MakeSpan(order));
}

TriangleBvh::Node TriangleBvh::MakeNode(const Eigen::AlignedBox3d& box) const {
  Node node;
  for (int axis = 0; axis < 3; ++axis) {
    node.bounds[0][axis] = RoundedDown(box.min()[axis] - centre_[axis]);
    node.bounds[1][axis] = RoundedUp(box.max()[axis] - centre_[axis]);
  }
  return node;
}

Eigen::AlignedBox3d TriangleBvh::AppendLeaf(const Mesh& mesh, absl::Span<const Entry> entries) {
  const auto first = static_cast<uint32_t>(triangles_.size());
  Eigen::AlignedBox3d box;
  for (const Entry& entry : entries) {
    const auto& [i, j, k] = mesh.triangles[entry.triangle];
    const Eigen::Vector3d &a = mesh.vertices[i], &b = mesh.vertices[j], &c = mesh.vertices[k];
    box.extend(a).extend(b).extend(c);
    triangles_.push_back({a, b - a, c - a, (b - a).cross(c - a).normalized()});
  }
  leaves_.push_back({box, first, static_cast<uint32_t>(entries.size())});
  return box;
}

Eigen::AlignedBox3d TriangleBvh::Build(const Mesh& mesh, absl::Span<Entry> entries) {
  const size_t node = nodes_.size();
  nodes_.emplace_back();
  Eigen::AlignedBox3d box;
  uint32_t first;
  const bool is_leaf = entries.size() <= kMaxLeafTriangles;
  if (is_leaf) {
    first = static_cast<uint32_t>(leaves_.size());
    box = AppendLeaf(mesh, entries);
  } else {
    if (entries.size() > kYieldTriangles) YieldPoint();
    Eigen::AlignedBox3d centres;
    for (const Entry& entry : entries) centres.extend(entry.centre);
    int axis;
    centres.sizes().maxCoeff(&axis);
    const size_t half = entries.size() / 2;
    // Ties are broken by index, so that the tree is a function of the mesh.
    std::nth_element(entries.begin(), entries.begin() + half, entries.end(), [axis](const Entry& a, const Entry& b) {
      return a.centre[axis] != b.centre[axis] ? a.centre[axis] < b.centre[axis] : a.triangle < b.triangle;
    });
    box = Build(mesh, entries.subspan(0, half));
    first = static_cast<uint32_t>(nodes_.size());
    box.extend(Build(mesh, entries.subspan(half)));
  }
  nodes_[node] = MakeNode(box);
  nodes_[node].first = first;
  nodes_[node].is_leaf = is_leaf ? 1 : 0;
  return box;
}

bool TriangleBvh::LeafOccludes(const Leaf& leaf, const Eigen::Vector3d& origin, const Eigen::Vector3d& point,
                               double plane_tolerance_m) const {
  const Eigen::Vector3d direction = point - origin;
  for (uint32_t i = leaf.first; i < leaf.first + leaf.count; ++i) {
    const Triangle& triangle = triangles_[i];
    const double point_height = triangle.normal.dot(point - triangle.corner);
    if (std::abs(point_height) <= plane_tolerance_m) continue;
    const double origin_height = triangle.normal.dot(origin - triangle.corner);
    if ((point_height > 0.0) == (origin_height > 0.0)) continue;
    const Eigen::Vector3d p = direction.cross(triangle.edge2);
    const double determinant = triangle.edge1.dot(p);
    const Eigen::Vector3d s = origin - triangle.corner;
    const double u = s.dot(p) / determinant;
    const double v = direction.dot(s.cross(triangle.edge1)) / determinant;
    if (!(u >= 0.0 && v >= 0.0 && u + v <= 1.0)) continue;
    // The boxes of the nodes are larger than the triangles. This test makes the result independent of that; it is
    // monotone in the box, so that those of the nodes above need no test.
    return MeetsBox(leaf.box, origin, direction, direction.cwiseInverse());
  }
  return false;
}

bool TriangleBvh::IsOccluded(const Eigen::Vector3d& origin, const Eigen::Vector3d& point,
                             double plane_tolerance_m) const {
  uint32_t none = ~0u;
  return IsOccluded(origin, point, plane_tolerance_m, none);
}

bool TriangleBvh::IsOccluded(const Eigen::Vector3d& origin, const Eigen::Vector3d& point, double plane_tolerance_m,
                             uint32_t& hint) const {
  if (nodes_.empty()) return false;
  if (hint < leaves_.size() && LeafOccludes(leaves_[hint], origin, point, plane_tolerance_m)) return true;
  const Ray ray(origin - centre_, point - origin, extent_m_);
  if (ray.Enter(nodes_[0]) == kMissed) return false;
  std::array<uint32_t, kMaxDepth> waiting;
  int waiting_count = 0;
  uint32_t current = 0;
  for (size_t visited = 0;; ++visited) {
    YieldPoint(visited);
    const Node& node = nodes_[current];
    if (node.is_leaf == 0) {
      uint32_t near = current + 1, far = node.first;
      float enter_near = ray.Enter(nodes_[near]), enter_far = ray.Enter(nodes_[far]);
      if (enter_far < enter_near) {
        std::swap(near, far);
        std::swap(enter_near, enter_far);
      }
      if (enter_far != kMissed) waiting[waiting_count++] = far;
      if (enter_near != kMissed) {
        current = near;
        continue;
      }
    } else if (node.first != hint && LeafOccludes(leaves_[node.first], origin, point, plane_tolerance_m)) {
      hint = node.first;
      return true;
    }
    if (waiting_count == 0) return false;
    current = waiting[--waiting_count];
  }
}

std::optional<TriangleBvh::Meeting> TriangleBvh::MeetLeaf(const Leaf& leaf, const Eigen::Vector3d& origin,
                                                          const Eigen::Vector3d& direction, double before) const {
  std::optional<Meeting> first;
  for (uint32_t i = leaf.first; i < leaf.first + leaf.count; ++i) {
    const Triangle& triangle = triangles_[i];
    const Eigen::Vector3d p = direction.cross(triangle.edge2);
    const double determinant = triangle.edge1.dot(p);
    if (determinant == 0.0) continue;
    const Eigen::Vector3d s = origin - triangle.corner;
    const Eigen::Vector3d q = s.cross(triangle.edge1);
    const double u = s.dot(p) / determinant, v = direction.dot(q) / determinant;
    const double at = triangle.edge2.dot(q) / determinant;
    if (!(u >= 0.0 && v >= 0.0 && u + v <= 1.0 && at >= 0.0 && at < before)) continue;
    before = at;
    first = Meeting{at, i};
  }
  return first;
}

std::optional<Eigen::Vector3d> TriangleBvh::FirstNormal(const Eigen::Vector3d& origin,
                                                        const Eigen::Vector3d& end) const {
  if (nodes_.empty()) return std::nullopt;
  const Eigen::Vector3d direction = end - origin;
  const Ray ray(origin - centre_, direction, extent_m_);
  Meeting first = {1.0, ~0u};
  std::array<std::pair<uint32_t, float>, kMaxDepth> waiting;  // nodes, and where the segment enters them
  int waiting_count = 0;
  uint32_t current = 0;
  float entered = ray.Enter(nodes_[0]);
  for (size_t visited = 0;; ++visited) {
    YieldPoint(visited);
    const bool is_before = entered != kMissed && entered <= first.at + kParameterSlack;
    const Node& node = nodes_[current];
    if (is_before && node.is_leaf == 0) {
      uint32_t near = current + 1, far = node.first;
      float enter_near = ray.Enter(nodes_[near]), enter_far = ray.Enter(nodes_[far]);
      if (enter_far < enter_near) {
        std::swap(near, far);
        std::swap(enter_near, enter_far);
      }
      if (enter_far != kMissed) waiting[waiting_count++] = {far, enter_far};
      current = near;
      entered = enter_near;
      continue;
    }
    if (is_before) first = MeetLeaf(leaves_[node.first], origin, direction, first.at).value_or(first);
    if (waiting_count == 0) break;
    std::tie(current, entered) = waiting[--waiting_count];
  }
  if (first.triangle == ~0u) return std::nullopt;
  const Eigen::Vector3d& normal = triangles_[first.triangle].normal;
  return normal.dot(direction) > 0.0 ? Eigen::Vector3d(-normal) : normal;
}

double TriangleBvh::Triangle::SquaredDistance(const Eigen::Vector3d& point) const {
  const Eigen::Vector3d s = point - corner;
  const double area = edge1.cross(edge2).dot(normal);
  const double u = s.cross(edge2).dot(normal) / area;
  const double v = edge1.cross(s).dot(normal) / area;
  if (u >= 0.0 && v >= 0.0 && u + v <= 1.0) return s.dot(normal) * s.dot(normal);
  return std::min({SquaredDistanceToSegment(point, corner, edge1), SquaredDistanceToSegment(point, corner, edge2),
                   SquaredDistanceToSegment(point, corner + edge1, edge2 - edge1)});
}

template <typename Visit>
void TriangleBvh::VisitNear(const Eigen::Vector3d& point, double radius_m, const Visit& visit) const {
  if (nodes_.empty()) return;
  std::array<uint32_t, kMaxDepth> waiting;
  int waiting_count = 0;
  uint32_t current = 0;
  const Eigen::Vector3d relative = point - centre_;
  // The exact box of a leaf decides; those of the nodes are enlarged beyond the rounding errors.
  const double slack_m = kCoordinateSlack * (relative.cwiseAbs().maxCoeff() + extent_m_);
  const double node_radius2 = (radius_m + 2.0 * slack_m) * (radius_m + 2.0 * slack_m);
  while (true) {
    const Node& node = nodes_[current];
    if (SquaredDistanceToBounds(relative, node.bounds) <= node_radius2) {
      if (node.is_leaf == 0) {
        waiting[waiting_count++] = node.first;
        ++current;
        continue;
      }
      const Leaf& leaf = leaves_[node.first];
      if (leaf.box.squaredExteriorDistance(point) <= radius_m * radius_m) {
        for (uint32_t i = leaf.first; i < leaf.first + leaf.count; ++i) {
          const double distance2 = triangles_[i].SquaredDistance(point);
          if (distance2 <= radius_m * radius_m && visit(triangles_[i], distance2)) return;
        }
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
  uint32_t none = ~0u;
  return HasNear(point, radius_m, direction, min_cosine, none);
}

bool TriangleBvh::HasNear(const Eigen::Vector3d& point, double radius_m, const Eigen::Vector3d& direction,
                          double min_cosine, uint32_t& hint) const {
  const auto is_along = [&](const Triangle& triangle) { return triangle.normal.dot(direction) >= min_cosine; };
  if (hint < triangles_.size() && is_along(triangles_[hint]) &&
      triangles_[hint].SquaredDistance(point) <= radius_m * radius_m) {
    return true;
  }
  bool has_near = false;
  VisitNear(point, radius_m, [&](const Triangle& triangle, double) {
    has_near = is_along(triangle);
    if (has_near) hint = static_cast<uint32_t>(&triangle - triangles_.data());
    return has_near;
  });
  return has_near;
}

}  // namespace evpose
