// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/smooth_mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>
#include <tuple>

#include "absl/types/span.h"
#include "core/mesh/mesh_edges.h"
#include "core/mesh/triangle_bvh.h"

namespace evpose {
namespace {

using Eigen::Vector3d;

constexpr size_t kMaxTriangles = 2'000'000;  // bounds the memory
constexpr int kMaxPasses = 14;               // each halves the edges: the longest edge becomes 16384 times shorter
constexpr uint32_t kNoPoint = ~0u;

// One side of an edge: the edge from corner k to corner k + 1 of a triangle, as 3 triangle + k.
struct EdgeSide {
  uint32_t low, high;  // points
  uint32_t side;

  auto Key() const { return std::tuple(low, high, side); }
};

std::vector<EdgeSide> SortedSides(const std::vector<std::array<uint32_t, 3>>& triangles) {
  std::vector<EdgeSide> sides;
  sides.reserve(3 * triangles.size());
  for (size_t i = 0; i < triangles.size(); ++i) {
    for (size_t k = 0; k < 3; ++k) {
      const auto [low, high] = std::minmax(triangles[i][k], triangles[i][(k + 1) % 3]);
      sides.push_back({low, high, static_cast<uint32_t>(3 * i + k)});
    }
  }
  std::sort(sides.begin(), sides.end(), [](const EdgeSide& a, const EdgeSide& b) { return a.Key() < b.Key(); });
  return sides;
}

Vector3d FaceNormal(const SmoothMesh& mesh, size_t triangle) {
  const auto& [a, b, c] = mesh.triangles[triangle];
  const Vector3d normal = (mesh.points[b] - mesh.points[a]).cross(mesh.points[c] - mesh.points[a]);
  const double length = normal.norm();
  return length > 0.0 ? Vector3d(normal / length) : Vector3d::Zero();
}

// The surface above the middle of an edge, for one of its sides: its normal, and its height along this normal
// (equations (5) and (6) of the README).
struct Middle {
  Vector3d normal;
  double height_m = 0.0;
};

Middle MiddleOf(const Vector3d& p1, const Vector3d& p2, const Vector3d& n1, const Vector3d& n2) {
  const Vector3d along = p2 - p1;
  const Vector3d sum = n1 + n2;
  const Vector3d normal = sum - along * (2.0 * along.dot(sum) / along.squaredNorm());
  const double length = normal.norm();
  // Normals that differ by a right angle or more, as at the tip of a cone, determine no surface between them.
  if (n1.dot(n2) <= 0.0 || !(length >= 0.5)) return {n1, 0.0};
  const Vector3d unit = normal / length;
  const double rise1 = along.dot(n1) / (1.0 + n1.dot(unit));
  const double rise2 = -along.dot(n2) / (1.0 + n2.dot(unit));
  return {unit, -0.25 * (rise1 + rise2)};
}

// The displacement of the middle of an edge that is on both surfaces, to first order: equation (7) of the README.
Vector3d DisplacementOnBoth(const Middle& a, const Middle& b) {
  // Two normals within 10 degrees are those of one smooth surface.
  constexpr double kSame = 0.985;
  const double cosine = a.normal.dot(b.normal);
  if (std::abs(cosine) > kSame) return 0.5 * (a.height_m * a.normal + b.height_m * b.normal);
  const double scale = 1.0 / (1.0 - cosine * cosine);
  return scale * ((a.height_m - cosine * b.height_m) * a.normal + (b.height_m - cosine * a.height_m) * b.normal);
}

class Subdivider {
 public:
  Subdivider(double tolerance_m, double max_edge_m, SmoothMesh& mesh)
      : tolerance_m_(tolerance_m), max_edge_m_(max_edge_m), mesh_(mesh) {}

  // Returns whether an edge was divided.
  bool Pass() {
    middle_point_.assign(3 * mesh_.triangles.size(), kNoPoint);
    middle_normal_.resize(middle_point_.size());
    const size_t num_points = mesh_.points.size();
    ForEachEdge(SortedSides(mesh_.triangles), [this](absl::Span<const EdgeSide> sides) { DivideEdge(sides); });
    if (mesh_.points.size() == num_points) return false;
    DivideTriangles();
    return true;
  }

 private:
  struct Corner {
    uint32_t point;
    Vector3d normal;
  };

  Middle MiddleAt(uint32_t side) const {
    const size_t triangle = side / 3, from = side % 3, to = (from + 1) % 3;
    const auto& corners = mesh_.triangles[triangle];
    const auto& normals = mesh_.normals[triangle];
    return MiddleOf(mesh_.points[corners[from]], mesh_.points[corners[to]], normals[from], normals[to]);
  }

  void DivideEdge(absl::Span<const EdgeSide> sides) {
    const Vector3d p1 = mesh_.points[sides[0].low];
    const Vector3d p2 = mesh_.points[sides[0].high];
    const double length_m = (p2 - p1).norm();
    const Middle first = MiddleAt(sides[0].side);
    Vector3d displacement = first.height_m * first.normal;
    if (sides.size() == 2) displacement = DisplacementOnBoth(first, MiddleAt(sides[1].side));
    // Larger than of a half circle's chord: the normals are those of no surface through the points. Where more than two
    // faces meet, no curve is on all of them.
    if (sides.size() > 2 || displacement.norm() > 0.5 * length_m) displacement.setZero();
    if (displacement.norm() <= tolerance_m_ && length_m <= max_edge_m_) return;
    const auto point = static_cast<uint32_t>(mesh_.points.size());
    mesh_.points.emplace_back(0.5 * (p1 + p2) + displacement);
    for (const EdgeSide& side : sides) {
      middle_point_[side.side] = point;
      middle_normal_[side.side] = MiddleAt(side.side).normal;
    }
  }

  void DivideTriangles() {
    const SmoothMesh old = {{}, std::move(mesh_.triangles), std::move(mesh_.normals)};
    mesh_.triangles.clear();
    mesh_.normals.clear();
    for (size_t i = 0; i < old.triangles.size(); ++i) {
      std::array<Corner, 3> corners;
      std::array<Corner, 3> middles;
      for (size_t k = 0; k < 3; ++k) {
        corners[k] = {old.triangles[i][k], old.normals[i][k]};
        middles[k] = {middle_point_[3 * i + k], middle_normal_[3 * i + k]};
      }
      DivideTriangle(corners, middles);
    }
  }

  void DivideTriangle(std::array<Corner, 3> corners, std::array<Corner, 3> middles) {
    const auto is_divided = [&](size_t k) { return middles[k].point != kNoPoint; };
    const int divided = is_divided(0) + is_divided(1) + is_divided(2);
    // The order is turned, so that a single divided edge is the first one and a single undivided edge is the last one.
    while ((divided == 1 && !is_divided(0)) || (divided == 2 && is_divided(2))) {
      std::rotate(corners.begin(), corners.begin() + 1, corners.end());
      std::rotate(middles.begin(), middles.begin() + 1, middles.end());
    }
    const auto& [a, b, c] = corners;
    const auto& [ab, bc, ca] = middles;
    if (divided == 0) return Add(a, b, c);
    if (divided == 1) {
      Add(a, ab, c);
      return Add(ab, b, c);
    }
    Add(ab, b, bc);
    if (divided == 2) {
      Add(a, ab, bc);
      return Add(a, bc, c);
    }
    Add(a, ab, ca);
    Add(ca, bc, c);
    Add(ab, bc, ca);
  }

  void Add(const Corner& a, const Corner& b, const Corner& c) {
    mesh_.triangles.push_back({a.point, b.point, c.point});
    mesh_.normals.push_back({a.normal, b.normal, c.normal});
  }

  const double tolerance_m_;
  const double max_edge_m_;
  SmoothMesh& mesh_;
  std::vector<uint32_t> middle_point_;  // by side; kNoPoint: the edge is not divided
  std::vector<Vector3d> middle_normal_;
};

// Appends a strip about the line from `begin` to `end` on a face with this normal.
void AddStrip(const Vector3d& begin, const Vector3d& end, const Vector3d& normal, double width_m, double max_part_m,
              SmoothMesh& mesh) {
  constexpr double kMaxParts = 1000.0;  // bounds the number of triangles of a line
  const Vector3d along = end - begin;
  const Vector3d across = 0.5 * width_m * normal.cross(along).normalized();
  const int num_parts = static_cast<int>(std::clamp(std::ceil(along.norm() / max_part_m), 1.0, kMaxParts));
  for (int part = 0; part < num_parts && mesh.triangles.size() < kMaxTriangles; ++part) {
    const Vector3d from = begin + static_cast<double>(part) / num_parts * along;
    const Vector3d to = begin + static_cast<double>(part + 1) / num_parts * along;
    const auto first = static_cast<uint32_t>(mesh.points.size());
    mesh.points.insert(mesh.points.end(), {from - across, to - across, to + across, from + across});
    mesh.triangles.push_back({first, first + 1, first + 2});
    mesh.triangles.push_back({first, first + 2, first + 3});
    mesh.normals.resize(mesh.triangles.size(), {normal, normal, normal});
  }
}

// Whether both sides of the middle of a strip lie on the surface: a line on the border of an open surface has an edge
// without paint, as the white part of a sheet has where the ink begins.
bool IsInside(const ModelLine& line, double width_m, const TriangleBvh& faces) {
  const Vector3d& normal = line.face_normals.front();
  const Vector3d across = 0.5 * width_m * normal.cross(line.p2 - line.p1).normalized();
  const Vector3d middle = 0.5 * (line.p1 + line.p2);
  constexpr double kMinCosine = 0.5;  // any face on this side of the surface
  const double radius_m = 0.25 * width_m;
  return faces.HasNear(middle + across, radius_m, normal, kMinCosine) &&
         faces.HasNear(middle - across, radius_m, normal, kMinCosine);
}

}  // namespace

SmoothMesh PaintedStrips(const ObjectModel& model, double width_m, double max_part_m) {
  SmoothMesh mesh;
  const auto is_painted = [](const ModelLine& line) {
    return line.kind == EdgeKind::kPainted && !line.face_normals.empty();
  };
  std::optional<TriangleBvh> faces;
  if (std::any_of(model.lines.begin(), model.lines.end(), is_painted)) faces.emplace(model.vertices, model.triangles);
  for (const ModelLine& line : model.lines) {
    if (!is_painted(line) || !IsInside(line, width_m, *faces)) continue;
    AddStrip(line.p1, line.p2, line.face_normals.front(), width_m, max_part_m, mesh);
  }
  for (const EdgeCurve& curve : model.curves) {
    if (curve.kind != EdgeKind::kPainted) continue;
    for (size_t i = 0; i < curve.face_normals.size(); ++i) {
      const Vector3d& normal = curve.face_normals[i].front();
      if (!normal.isZero()) AddStrip(curve.points[i], curve.points[i + 1], normal, width_m, max_part_m, mesh);
    }
  }
  return mesh;
}

SmoothMesh MakeSmoothMesh(const ObjectModel& model) {
  SmoothMesh mesh = {model.vertices, model.triangles, {}};
  mesh.normals.resize(mesh.triangles.size());
  for (size_t i = 0; i < mesh.triangles.size(); ++i) {
    mesh.normals[i].fill(FaceNormal(mesh, i));
    if (model.surface.empty() || model.surface.regions[model.surface.region_of[i]].is_flat()) continue;
    for (size_t k = 0; k < 3; ++k) {
      const Vector3d normal = model.surface.normals[i][k].cast<double>();
      const double length = normal.norm();
      if (length > 0.5) mesh.normals[i][k] = normal / length;
    }
  }
  return mesh;
}

void Subdivide(double tolerance_m, double max_edge_m, SmoothMesh& mesh) {
  Subdivider subdivider(tolerance_m, max_edge_m, mesh);
  for (int pass = 0; pass < kMaxPasses && mesh.triangles.size() <= kMaxTriangles / 4; ++pass) {
    if (!subdivider.Pass()) return;
  }
}

bool IsClosed(const SmoothMesh& mesh) {
  bool is_closed = true;
  const auto starts_low = [&](const EdgeSide& side) {
    return mesh.triangles[side.side / 3][side.side % 3] == side.low;
  };
  ForEachEdge(SortedSides(mesh.triangles), [&](absl::Span<const EdgeSide> sides) {
    is_closed = is_closed && sides.size() == 2 && starts_low(sides[0]) != starts_low(sides[1]);
  });
  return is_closed;
}

}  // namespace evpose
