// SPDX-License-Identifier: Apache-2.0
#include "core/contours/contour_mesh.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>
#include <utility>

#include "core/base/yield_point.h"
#include "core/mesh/region_shapes.h"
#include "core/numerics/target_clones.h"

namespace evpose {
namespace {

// Parts into which a segment is divided at most: bounds the time on coarse meshes. The sagitta of the parts is 1/64 of
// that of the segment.
constexpr int kMaxParts = 8;

// Whether a region may show an occluding contour: the wall of a hole is concave along every ray and hides its own.
bool HasContour(const SurfaceRegion& region) {
  if (region.is_flat()) return false;
  return region.shape == RegionShape::kFree || region.is_convex;
}

// Sorts by `key`, a number below `num_keys`, then by `is_before`. Linear in the number of values if few have the same
// key.
template <typename Value, typename Key, typename Before>
void SortByKey(size_t num_keys, const Key& key, const Before& is_before, std::vector<Value>& values) {
  std::vector<size_t> begins(num_keys + 1, 0);
  for (const Value& value : values) ++begins[key(value) + 1];
  std::partial_sum(begins.begin(), begins.end(), begins.begin());
  std::vector<size_t> ends(begins.begin(), begins.end() - 1);
  std::vector<Value> sorted(values.size());
  for (const Value& value : values) sorted[ends[key(value)]++] = value;
  for (size_t k = 0; k < num_keys; ++k) {
    YieldPoint(k);
    std::sort(sorted.begin() + static_cast<std::ptrdiff_t>(begins[k]),
              sorted.begin() + static_cast<std::ptrdiff_t>(ends[k]), is_before);
  }
  values = std::move(sorted);
}

}  // namespace

EVPOSE_CLONES void SubtractEye(const double* x, const double* y, const double* z, const Eigen::Vector3d& eye,
                               size_t count, double* heights, uint8_t* is_back) {
  const double eye_x = eye.x(), eye_y = eye.y(), eye_z = eye.z();
  for (size_t i = 0; i < count; ++i) {
    heights[i] -= (x[i] * eye_x + y[i] * eye_y) + z[i] * eye_z;
    is_back[i] = heights[i] >= 0.0;
  }
}

struct ContourMesh::EyeHeights {
  Eigen::Vector3d eye;
  double max_sagitta_rad;
  std::vector<double> heights_m;  // n . (p - eye) at each corner: negative where the surface faces the eye
  std::vector<uint8_t> is_back;
};

ContourMesh::ContourMesh(const ObjectModel& model) : model_(model) {
  region_number_.assign(model.surface.regions.size(), kNone);
  for (size_t region = 0; region < region_number_.size(); ++region) {
    if (HasContour(model.surface.regions[region])) region_number_[region] = num_regions_++;
  }
  if (num_regions_ == 0) return;
  AddTriangles(region_number_);
  LinkTriangles();
}

// Corners of one region with the same vertex and normal become one, so that what is computed for them is computed once
// and agrees in all triangles.
void ContourMesh::AddTriangles(const std::vector<uint32_t>& curved_number) {
  const SmoothSurface& surface = model_.surface;
  std::vector<uint32_t> uses;  // 3 * triangle + corner
  std::vector<uint32_t> index_of(model_.triangles.size(), kNone);
  for (size_t i = 0; i < model_.triangles.size(); ++i) {
    if (curved_number[surface.region_of[i]] == kNone) continue;
    index_of[i] = static_cast<uint32_t>(triangles_.size());
    triangles_.push_back({{}, {kNone, kNone, kNone}, surface.region_of[i]});
    for (uint32_t k = 0; k < 3; ++k) uses.push_back(static_cast<uint32_t>(3 * i) + k);
  }
  const auto vertex_of = [&](uint32_t use) { return model_.triangles[use / 3][use % 3]; };
  const auto key = [&](uint32_t use) {
    const Eigen::Vector3f& n = surface.normals[use / 3][use % 3];
    return std::tuple(vertex_of(use), surface.region_of[use / 3], n.x(), n.y(), n.z());
  };
  const auto is_before = [&](uint32_t a, uint32_t b) {
    const auto key_a = key(a), key_b = key(b);
    return key_a != key_b ? key_a < key_b : a < b;
  };
  SortByKey(model_.vertices.size(), vertex_of, is_before, uses);
  for (size_t i = 0; i < uses.size(); ++i) {
    const uint32_t triangle = uses[i] / 3, corner = uses[i] % 3;
    if (i == 0 || key(uses[i]) != key(uses[i - 1])) {
      const Eigen::Vector3d normal = surface.normals[triangle][corner].cast<double>();
      points_.push_back(model_.vertices[model_.triangles[triangle][corner]]);
      for (int axis = 0; axis < 3; ++axis) normals_[axis].push_back(normal[axis]);
      heights_m_.push_back(normal.dot(points_.back()));
    }
    triangles_[index_of[triangle]].corners[corner] = static_cast<uint32_t>(points_.size() - 1);
  }
  for (const Triangle& triangle : triangles_) corners_of_.push_back(triangle.corners);
}

// Two triangles with the same two corners in opposite order are neighbours.
void ContourMesh::LinkTriangles() {
  struct Side {
    uint32_t low, high;  // corners
    uint32_t half_edge;  // 3 * triangle + edge
    bool is_reversed;
  };
  std::vector<Side> sides;
  sides.reserve(3 * triangles_.size());
  for (uint32_t i = 0; i < triangles_.size(); ++i) {
    for (uint32_t k = 0; k < 3; ++k) {
      const uint32_t a = triangles_[i].corners[k], b = triangles_[i].corners[(k + 1) % 3];
      sides.push_back({std::min(a, b), std::max(a, b), 3 * i + k, a > b});
    }
  }
  const auto is_before = [](const Side& a, const Side& b) {
    return std::tie(a.high, a.half_edge) < std::tie(b.high, b.half_edge);
  };
  SortByKey(
      points_.size(), [](const Side& side) { return side.low; }, is_before, sides);
  for (size_t begin = 0, end; begin < sides.size(); begin = end) {
    for (end = begin + 1; end < sides.size(); ++end) {
      if (sides[end].low != sides[begin].low || sides[end].high != sides[begin].high) break;
    }
    const Side& a = sides[begin];
    const Side& b = sides[end - 1];
    if (end - begin != 2 || a.is_reversed == b.is_reversed) continue;
    triangles_[a.half_edge / 3].neighbours[a.half_edge % 3] = b.half_edge;
    triangles_[b.half_edge / 3].neighbours[b.half_edge % 3] = a.half_edge;
  }
}

std::vector<ContourMesh::Crossing> ContourMesh::FindCrossings(const EyeHeights& eye_heights) const {
  std::vector<Crossing> crossings;
  const uint8_t* const is_back = eye_heights.is_back.data();
  for (uint32_t i = 0; i < corners_of_.size(); ++i) {
    const auto& [a, b, c] = corners_of_[i];
    const unsigned backs = is_back[a] | is_back[b] << 1 | is_back[c] << 2;
    if (backs == 0 || backs == 7) continue;
    Crossing crossing{i, 0, 0, false};
    for (uint8_t k = 0; k < 3; ++k) {
      const bool from_back = (backs >> k & 1) != 0, to_back = (backs >> (k + 1) % 3 & 1) != 0;
      if (from_back && !to_back) crossing.in = k;
      if (!from_back && to_back) crossing.out = k;
    }
    crossings.push_back(crossing);
  }
  return crossings;
}

Eigen::Vector3d ContourMesh::CrossingOfEdge(const EyeHeights& eye_heights, const Triangle& triangle, int edge) const {
  const int next = (edge + 1) % 3;
  // The corners have the same order from both triangles, so that both compute the same bits.
  const bool is_reversed = triangle.corners[edge] > triangle.corners[next];
  const int low = is_reversed ? next : edge, high = is_reversed ? edge : next;
  const double low_m = eye_heights.heights_m[triangle.corners[low]],
               high_m = eye_heights.heights_m[triangle.corners[high]];
  const double fraction = low_m / (low_m - high_m);
  Eigen::Vector3d barycentric = Eigen::Vector3d::Zero();
  barycentric[low] = 1.0 - fraction;
  barycentric[high] = fraction;
  return barycentric;
}

// core/contours/README.md, equation (4): the height grows along the ray by the curvature times the distance.
double ContourMesh::CurvatureAlongRay(const EyeHeights& eye_heights, const Triangle& triangle,
                                      const Eigen::Vector3d& ray) const {
  const auto& [a, b, c] = triangle.corners;
  const Eigen::Vector3d edge1 = points_[b] - points_[a], edge2 = points_[c] - points_[a];
  const double e11 = edge1.squaredNorm(), e12 = edge1.dot(edge2), e22 = edge2.squaredNorm();
  const double determinant = e11 * e22 - e12 * e12;
  if (!(determinant > 0.0)) return 0.0;
  const double r1 = edge1.dot(ray), r2 = edge2.dot(ray);
  const double growth = (e22 * r1 - e12 * r2) * (eye_heights.heights_m[b] - eye_heights.heights_m[a]) +
                        (e11 * r2 - e12 * r1) * (eye_heights.heights_m[c] - eye_heights.heights_m[a]);
  return growth / (determinant * ray.squaredNorm());
}

RimPoint ContourMesh::MakeRimPoint(const EyeHeights& eye_heights, const Triangle& triangle, const Triangle& other,
                                   const Eigen::Vector3d& barycentric) const {
  std::array<Eigen::Vector3d, 3> corners, normals;
  Eigen::Vector3d mesh_point = Eigen::Vector3d::Zero(), normal = Eigen::Vector3d::Zero();
  for (int k = 0; k < 3; ++k) {
    const uint32_t corner = triangle.corners[k];
    corners[k] = points_[corner];
    normals[k] = {normals_[0][corner], normals_[1][corner], normals_[2][corner]};
    mesh_point += barycentric[k] * corners[k];
    normal += barycentric[k] * normals[k];
  }
  const SurfaceRegion& region = model_.surface.regions[triangle.region];
  if (region.shape != RegionShape::kFree) {
    const Eigen::Vector3d surface_point = ProjectToShape(region, mesh_point);
    return RimOfShape(region, eye_heights.eye, surface_point, NormalOfShape(region, surface_point), model_.diameter_m);
  }
  const Eigen::Vector3d ray = mesh_point - eye_heights.eye;
  const double length = normal.norm();
  const double curvature = CurvatureAlongRay(eye_heights, triangle, ray) + CurvatureAlongRay(eye_heights, other, ray);
  if (!(length > 0.0) || !(curvature > 0.0)) return {mesh_point, Eigen::Vector3d::Zero(), 0.0};
  RimPoint rim{SmoothPoint(corners, normals, barycentric), normal / length, 0.0};
  // The mean of the two triangles. The gradient is that of a normal of this length.
  const double radius_m = std::min(2.0 * length / curvature, model_.diameter_m);
  if (MoveToRim(eye_heights.eye, radius_m, rim.point, rim.normal)) rim.radius_m = radius_m;
  return rim;
}

void ContourMesh::AppendDivided(const EyeHeights& eye_heights, const Triangle& triangle, const Eigen::Vector3d& from,
                                const Eigen::Vector3d& to, const RimPoint& end, Rims& rims) const {
  const RimPoint start = rims.points.back();
  int num_parts = 1;
  if (start.is_convex() && end.is_convex()) {
    // core/contours/README.md, equation (8).
    const double sagitta_m = std::abs((end.normal - start.normal).dot(end.point - start.point)) / 8.0;
    const double ratio = sagitta_m / (eye_heights.max_sagitta_rad * (end.point - eye_heights.eye).norm());
    while (num_parts < kMaxParts && num_parts * num_parts < ratio) ++num_parts;
  }
  for (int part = 1; part < num_parts; ++part) {
    const double fraction = static_cast<double>(part) / num_parts;
    rims.points.push_back(MakeRimPoint(eye_heights, triangle, triangle, from + fraction * (to - from)));
  }
  rims.points.push_back(end);
}

void ContourMesh::FollowContour(const EyeHeights& eye_heights, absl::Span<Crossing> crossings, size_t first,
                                Rims& rims) const {
  Crossing* crossing = &crossings[first];
  const uint32_t first_neighbour = triangles_[crossing->triangle].neighbours[crossing->in];
  const auto begin = static_cast<uint32_t>(rims.points.size());
  {
    const Triangle& triangle = triangles_[crossing->triangle];
    const Triangle& other = first_neighbour == kNone ? triangle : triangles_[first_neighbour / 3];
    rims.points.push_back(
        MakeRimPoint(eye_heights, triangle, other, CrossingOfEdge(eye_heights, triangle, crossing->in)));
  }
  bool is_ring = false;
  while (true) {
    crossing->is_visited = true;
    const Triangle& triangle = triangles_[crossing->triangle];
    const uint32_t neighbour = triangle.neighbours[crossing->out];
    is_ring = neighbour != kNone && neighbour / 3 == crossings[first].triangle;
    const Eigen::Vector3d from = CrossingOfEdge(eye_heights, triangle, crossing->in);
    const Eigen::Vector3d to = CrossingOfEdge(eye_heights, triangle, crossing->out);
    const Triangle& other = neighbour == kNone ? triangle : triangles_[neighbour / 3];
    const RimPoint end = is_ring ? rims.points[begin] : MakeRimPoint(eye_heights, triangle, other, to);
    AppendDivided(eye_heights, triangle, from, to, end, rims);
    if (neighbour == kNone || is_ring) break;
    crossing = &*std::lower_bound(crossings.begin(), crossings.end(), neighbour / 3,
                                  [](const Crossing& c, uint32_t index) { return c.triangle < index; });
  }
  rims.chains.push_back({region_number_[triangles_[crossings[first].triangle].region], begin,
                         static_cast<uint32_t>(rims.points.size()), is_ring});
}

void ContourMesh::FindRims(const Eigen::Vector3d& eye, double max_sagitta_rad, Rims& rims) const {
  rims.points.clear();
  rims.chains.clear();
  if (triangles_.empty()) return;
  EyeHeights eye_heights{eye, max_sagitta_rad, heights_m_, std::vector<uint8_t>(heights_m_.size())};
  SubtractEye(normals_[0].data(), normals_[1].data(), normals_[2].data(), eye, heights_m_.size(),
              eye_heights.heights_m.data(), eye_heights.is_back.data());
  std::vector<Crossing> crossings = FindCrossings(eye_heights);
  // Contours that end at the border of a region first, from their beginning; what remains are rings.
  for (const bool is_open : {true, false}) {
    for (size_t i = 0; i < crossings.size(); ++i) {
      YieldPoint(i);
      const Crossing& crossing = crossings[i];
      if (crossing.is_visited) continue;
      if (is_open && triangles_[crossing.triangle].neighbours[crossing.in] != kNone) continue;
      FollowContour(eye_heights, absl::MakeSpan(crossings), i, rims);
    }
  }
}

}  // namespace evpose
