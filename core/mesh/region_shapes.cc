// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/region_shapes.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/mesh/region_parts.h"
#include "core/mesh/region_triangles.h"
#include "core/mesh/shape_fit.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// A corner takes the normal of the shape with which it shares the vertex, if it differs by less: 30 degrees for a mean
// over facets, of which the first beside a shape turns by half a step; 3 degrees for another shape.
constexpr double kMaxTurnOfMean = 0.52, kMaxTurnOfShape = 0.05;
// Normals at one vertex that are compared with those of each other triangle there: bounds the time of a fan.
constexpr int kMaxNormalsAtVertex = 64;

void SetNormals(const RawMesh& mesh, absl::Span<const uint32_t> triangles, const SurfaceRegion& region,
                SmoothSurface& surface) {
  for (const uint32_t t : triangles) {
    const FacetGeometry facet = FacetOf(mesh, t);
    for (int corner = 0; corner < 3; ++corner) {
      const Eigen::Vector3d normal = CornerNormal(region, mesh.points[mesh.triangles[t][corner]], facet);
      if (!normal.isZero()) surface.normals[t][corner] = normal.cast<float>();
    }
  }
}

// The normals of parts at their vertices.
class NormalsAtVertices {
 public:
  void Add(const RawMesh& mesh, const RegionPart& part) {
    for (const uint32_t t : part.triangles) {
      const FacetGeometry facet = FacetOf(mesh, t);
      for (const uint32_t vertex : mesh.triangles[t]) {
        entries_.push_back({vertex, CornerNormal(part.region, mesh.points[vertex], facet)});
      }
    }
  }
  // Sorts the entries; to be called after the last addition and before the first query.
  void Sort() {
    std::stable_sort(entries_.begin(), entries_.end(),
                     [](const Entry& a, const Entry& b) { return a.vertex < b.vertex; });
  }
  // Makes the normal at a vertex the mean of those there that differ by less than `max_turn`.
  void Continue(uint32_t vertex, double max_turn, Eigen::Vector3f& normal) const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    auto entry = std::lower_bound(entries_.begin(), entries_.end(), vertex,
                                  [](const Entry& a, uint32_t b) { return a.vertex < b; });
    for (int i = 0; i < kMaxNormalsAtVertex && entry != entries_.end() && entry->vertex == vertex; ++i, ++entry) {
      if ((entry->normal - normal.cast<double>()).norm() < max_turn) sum += entry->normal;
    }
    if (!sum.isZero()) normal = sum.normalized().cast<float>();
  }

 private:
  struct Entry {
    uint32_t vertex;
    Eigen::Vector3d normal;
  };
  std::vector<Entry> entries_;
};

void ContinueNormals(const RawMesh& mesh, const RegionPart& part, const NormalsAtVertices& normals, double max_turn,
                     SmoothSurface& surface) {
  for (const uint32_t t : part.triangles) {
    for (int corner = 0; corner < 3; ++corner) {
      normals.Continue(mesh.triangles[t][corner], max_turn, surface.normals[t][corner]);
    }
  }
}

// The first part keeps the number of the region. Curved shapes continue the normals of planes, and free parts those of
// both: if the normals jumped at the border, a contour that crosses it would be lost.
void SetParts(const RawMesh& mesh, const std::vector<RegionPart>& parts, uint32_t region, SmoothSurface& surface) {
  NormalsAtVertices planes, shapes;
  for (const RegionPart& part : parts) {
    if (&part != &parts.front()) {
      region = static_cast<uint32_t>(surface.regions.size());
      surface.regions.emplace_back();
    }
    surface.regions[region] = part.region;
    for (const uint32_t t : part.triangles) surface.region_of[t] = region;
    SetNormals(mesh, part.triangles, part.region, surface);
    if (part.region.is_flat()) planes.Add(mesh, part);
    if (part.region.shape != RegionShape::kFree) shapes.Add(mesh, part);
  }
  planes.Sort();
  shapes.Sort();
  for (const RegionPart& part : parts) {
    if (part.region.is_flat()) continue;
    const bool is_free = part.region.shape == RegionShape::kFree;
    ContinueNormals(mesh, part, is_free ? shapes : planes, is_free ? kMaxTurnOfMean : kMaxTurnOfShape, surface);
  }
}

// Distance of the patch of a triangle (README, section 14) from the facet, at the middles of its sides and its
// centroid.
double PatchDistance(const std::array<Eigen::Vector3d, 3>& corners, const std::array<Eigen::Vector3d, 3>& normals) {
  double distance_m = 0.0;
  for (const Eigen::Vector3d& at : {Eigen::Vector3d(0.5, 0.5, 0.0), Eigen::Vector3d(0.0, 0.5, 0.5),
                                    Eigen::Vector3d(0.5, 0.0, 0.5), Eigen::Vector3d::Constant(1.0 / 3.0).eval()}) {
    const Eigen::Vector3d on_facet = at[0] * corners[0] + at[1] * corners[1] + at[2] * corners[2];
    distance_m = std::max(distance_m, (SmoothPoint(corners, normals, at) - on_facet).norm());
  }
  return distance_m;
}

// Gives triangles of free regions the normal of the facet if their patch would be too far from it.
void FlattenFarPatches(const RawMesh& mesh, double diameter_m, SmoothSurface& surface) {
  // Largest distance relative to the diameter. The patches of the coarsest tessellations of smooth shapes are up to
  // 0.0135 away. Those of long chamfers were 0.07 away, because the cut corners at their ends had tilted the normals.
  constexpr double kMaxDistance = 0.015;
  for (uint32_t t = 0; t < mesh.triangles.size(); ++t) {
    if (surface.regions[surface.region_of[t]].shape != RegionShape::kFree) continue;
    std::array<Eigen::Vector3d, 3> corners, normals;
    for (size_t i = 0; i < 3; ++i) {
      corners[i] = mesh.points[mesh.triangles[t][i]];
      normals[i] = surface.normals[t][i].cast<double>();
    }
    if (PatchDistance(corners, normals) <= kMaxDistance * diameter_m) continue;
    surface.normals[t].fill(FacetOf(mesh, t).normal.cast<float>());
  }
}

}  // namespace

void FitShapes(const RawMesh& mesh, double diameter_m, SmoothSurface& surface) {
  const RegionTriangles by_region(surface);
  const size_t num_regions = surface.regions.size();
  for (uint32_t region = 0; region < num_regions; ++region) {
    const absl::Span<const uint32_t> triangles = by_region.Of(region);
    if (surface.regions[region].shape != RegionShape::kFree || triangles.empty()) continue;
    if (const auto shape = FitShape(mesh, triangles, ShapeChoice::kAny, diameter_m)) {
      surface.regions[region] = *shape;
      SetNormals(mesh, triangles, *shape, surface);
      continue;
    }
    SetParts(mesh, FindRegionParts(mesh, triangles, diameter_m), region, surface);
  }
  FlattenFarPatches(mesh, diameter_m, surface);
}

Eigen::Vector3d ProjectToShape(const SurfaceRegion& region, const Eigen::Vector3d& point) {
  const Eigen::Vector3d v = point - region.point;
  if (region.shape == RegionShape::kFree) return point;
  if (region.shape == RegionShape::kPlane) return point - v.dot(region.axis) * region.axis;
  if (region.shape == RegionShape::kSphere) {
    const double distance = v.norm();
    return distance > 0.0 ? Eigen::Vector3d(region.point + v * (region.radius_m / distance)) : point;
  }
  const double h = v.dot(region.axis);
  const Eigen::Vector3d across = v - h * region.axis;
  const double distance = across.norm();
  if (!(distance > 0.0)) return point;
  if (region.shape == RegionShape::kCylinder) {
    return region.point + h * region.axis + across * (region.radius_m / distance);
  }
  const auto [s, c] = DeterministicSinCos(region.half_angle_rad);
  const double along = std::max(0.0, c * h + s * distance);  // on the generator, from the apex
  return region.point + along * (c * region.axis + across * (s / distance));
}

Eigen::Vector3d NormalOfShape(const SurfaceRegion& region, const Eigen::Vector3d& point) {
  if (region.shape == RegionShape::kFree) return Eigen::Vector3d::Zero();
  if (region.shape == RegionShape::kPlane) return region.axis;
  Eigen::Vector3d away = point - region.point;
  if (region.shape != RegionShape::kSphere) away -= away.dot(region.axis) * region.axis;
  const double distance = away.norm();
  if (!(distance > 0.0)) return Eigen::Vector3d::Zero();
  away /= distance;
  if (region.shape == RegionShape::kCone) {
    const auto [s, c] = DeterministicSinCos(region.half_angle_rad);
    away = c * away - s * region.axis;
  }
  return region.is_convex ? away : Eigen::Vector3d(-away);
}

Eigen::Vector3d SmoothPoint(const std::array<Eigen::Vector3d, 3>& corners,
                            const std::array<Eigen::Vector3d, 3>& normals, const Eigen::Vector3d& barycentric) {
  Eigen::Vector3d point = Eigen::Vector3d::Zero(), to_tangents = Eigen::Vector3d::Zero();
  for (int i = 0; i < 3; ++i) point += barycentric[i] * corners[i];
  for (int i = 0; i < 3; ++i) to_tangents += barycentric[i] * (corners[i] - point).dot(normals[i]) * normals[i];
  return point + 0.5 * to_tangents;
}

}  // namespace evpose
