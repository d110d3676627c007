// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/simplify.h"

#include <meshoptimizer.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "absl/types/span.h"
#include "core/mesh/region_triangles.h"
#include "core/mesh/triangle_bvh.h"

namespace evpose {
namespace {

// meshopt_simplify's cost per vertex is proportional to the square of the number of its triangles. Vertices with more
// keep all of them.
constexpr uint32_t kMaxTrianglesAtVertex = 256;
// A region has one normal at a vertex, unless a crease ends there. Squared difference, above rounding of floats.
constexpr float kMaxNormalDifference2 = 1e-6f;
// meshopt_simplify limits a mean distance over the planes of the triangles removed, which the largest exceeds.
constexpr double kLimitOfMean = 0.5;
constexpr double kNextLimit = 0.8;  // of the next attempt, times allowed / largest distance
// Attempts, each with a smaller limit of the mean, to keep the largest distance within the limit.
constexpr int kErrorAttempts = 4;
constexpr size_t kErrorSamples = 4096;
// Height of a triangle relative to its longest side below which it is a line.
constexpr double kMinReducedHeight = 1e-7;

// meshopt_simplify sums squares of coordinates in single precision, so that it does not resolve distances below some
// 3e-4 of the size of its input. Regions are therefore reduced cell by cell: so many triangles on average, and so many
// cells along the longest axis at most.
constexpr double kTrianglesPerCell = 2000.0, kMaxCells = 16.0;

constexpr uint32_t kNotCollected = ~0u;

struct ReducedTriangles {
  std::vector<std::array<uint32_t, 3>> corners;  // indices of points
  SmoothSurface surface;                         // without `regions`

  void Add(const std::array<uint32_t, 3>& triangle, uint32_t region, const std::array<Eigen::Vector3f, 3>& normals) {
    corners.push_back(triangle);
    surface.region_of.push_back(region);
    surface.normals.push_back(normals);
  }
};

bool HasNoArea(const RawMesh& mesh, const std::array<uint32_t, 3>& triangle) {
  const auto& [i, j, k] = triangle;
  const Eigen::Vector3d ab = mesh.points[j] - mesh.points[i], ac = mesh.points[k] - mesh.points[i];
  const double longest2 = std::max({ab.squaredNorm(), ac.squaredNorm(), (ac - ab).squaredNorm()});
  const double twice_area2 = ab.cross(ac).squaredNorm();
  return !(twice_area2 > kMinReducedHeight * kMinReducedHeight * longest2 * longest2);
}

class RegionSimplifier {
 public:
  RegionSimplifier(const RawMesh& mesh, const SmoothSurface& surface)
      : mesh_(mesh), surface_(surface), index_(mesh.points.size(), kNotCollected) {}

  // Appends the triangles of a region, reduced towards `target`, to `result`.
  void Simplify(uint32_t region, absl::Span<const uint32_t> triangles, size_t target, double error_m,
                ReducedTriangles& result) {
    CollectVertices(triangles);
    std::vector<uint32_t> indices;
    for (const uint32_t t : triangles) {
      const std::array<uint32_t, 3>& corners = mesh_.triangles[t];
      if (std::any_of(corners.begin(), corners.end(), [this](uint32_t v) { return IsFixed(vertices_[index_[v]]); })) {
        result.Add(corners, region, surface_.normals[t]);
      } else {
        for (const uint32_t vertex : corners) indices.push_back(index_[vertex]);
      }
    }
    for (const Vertex& vertex : vertices_) index_[vertex.point] = kNotCollected;
    const size_t fixed = triangles.size() - indices.size() / 3;
    Reduce(target > fixed ? target - fixed : 0, error_m, indices);
    for (size_t i = 0; i < indices.size(); i += 3) {
      const Vertex &a = vertices_[indices[i]], &b = vertices_[indices[i + 1]], &c = vertices_[indices[i + 2]];
      const std::array<uint32_t, 3> corners = {a.point, b.point, c.point};
      if (!HasNoArea(mesh_, corners)) result.Add(corners, region, {a.normal, b.normal, c.normal});
    }
  }

 private:
  struct Vertex {
    uint32_t point;
    uint32_t triangles = 0;
    Eigen::Vector3f normal;
    bool has_one_normal = true;
  };
  static bool IsFixed(const Vertex& vertex) {
    return !vertex.has_one_normal || vertex.triangles > kMaxTrianglesAtVertex;
  }

  void CollectVertices(absl::Span<const uint32_t> triangles) {
    vertices_.clear();
    box_.setEmpty();
    for (const uint32_t t : triangles) {
      for (int corner = 0; corner < 3; ++corner) {
        const uint32_t point = mesh_.triangles[t][corner];
        const Eigen::Vector3f& normal = surface_.normals[t][corner];
        if (index_[point] == kNotCollected) {
          index_[point] = static_cast<uint32_t>(vertices_.size());
          vertices_.push_back({point, 0, normal});
          box_.extend(mesh_.points[point]);
        }
        Vertex& vertex = vertices_[index_[point]];
        ++vertex.triangles;
        vertex.has_one_normal &= (vertex.normal - normal).squaredNorm() <= kMaxNormalDifference2;
      }
    }
  }

  // `indices` of `vertices_`, three for each triangle. The second pass removes vertices at the borders of the cells of
  // the first one, which are within its own cells.
  void Reduce(size_t target, double error_m, std::vector<uint32_t>& indices) {
    cell_index_.assign(vertices_.size(), kNotCollected);
    for (const double shift : {0.0, 0.5}) {
      if (indices.size() > 3 * target && box_.sizes().maxCoeff() > 0.0) ReduceCells(target, shift, error_m, indices);
    }
  }

  void ReduceCells(size_t target, double shift, double error_m, std::vector<uint32_t>& indices) {
    const size_t count = indices.size() / 3;
    const double cells = std::floor(std::sqrt(static_cast<double>(count) / kTrianglesPerCell));
    const double cells_per_m = std::clamp(cells, 1.0, kMaxCells) / box_.sizes().maxCoeff();
    std::vector<std::pair<uint32_t, uint32_t>> order;  // cell, triangle
    order.reserve(count);
    for (uint32_t t = 0; t < count; ++t) {
      Eigen::Vector3d centroid = Eigen::Vector3d::Zero();
      for (int corner = 0; corner < 3; ++corner)
        centroid += mesh_.points[vertices_[indices[3 * t + corner]].point] / 3.0;
      const Eigen::Array3d cell = (centroid - box_.min()).array() * cells_per_m + shift;
      const auto [x, y, z] = std::array<uint32_t, 3>{static_cast<uint32_t>(cell.x()), static_cast<uint32_t>(cell.y()),
                                                     static_cast<uint32_t>(cell.z())};
      order.emplace_back((x * 32 + y) * 32 + z, t);
    }
    std::sort(order.begin(), order.end());
    const double share = static_cast<double>(target) / static_cast<double>(count);
    std::vector<uint32_t> reduced, of_cell;
    for (size_t i = 0; i < count; ++i) {
      const uint32_t t = order[i].second;
      of_cell.insert(of_cell.end(), {indices[3 * t], indices[3 * t + 1], indices[3 * t + 2]});
      if (i + 1 < count && order[i + 1].first == order[i].first) continue;
      ReduceCell(static_cast<size_t>(share * static_cast<double>(of_cell.size() / 3)), error_m, of_cell);
      reduced.insert(reduced.end(), of_cell.begin(), of_cell.end());
      of_cell.clear();
    }
    indices = std::move(reduced);
  }

  void ReduceCell(size_t target, double error_m, std::vector<uint32_t>& indices) {
    std::vector<uint32_t> vertices;
    Eigen::AlignedBox3d box;
    for (uint32_t& index : indices) {
      if (cell_index_[index] == kNotCollected) {
        cell_index_[index] = static_cast<uint32_t>(vertices.size());
        vertices.push_back(index);
        box.extend(mesh_.points[vertices_[index].point]);
      }
      index = cell_index_[index];
    }
    for (const uint32_t vertex : vertices) cell_index_[vertex] = kNotCollected;
    const double extent_m = box.sizes().maxCoeff();
    if (indices.size() > 3 * target && extent_m > 0.0) {
      std::vector<float> positions;
      positions.reserve(3 * vertices.size());
      for (const uint32_t vertex : vertices) {
        const Eigen::Vector3f position = ((mesh_.points[vertices_[vertex].point] - box.min()) / extent_m).cast<float>();
        positions.insert(positions.end(), {position.x(), position.y(), position.z()});
      }
      indices.resize(meshopt_simplify(indices.data(), indices.data(), indices.size(), positions.data(), vertices.size(),
                                      3 * sizeof(float), 3 * target, static_cast<float>(error_m / extent_m),
                                      meshopt_SimplifyLockBorder, nullptr));
    }
    for (uint32_t& index : indices) index = vertices[index];
  }

  const RawMesh& mesh_;
  const SmoothSurface& surface_;
  std::vector<uint32_t> index_;  // of a point in `vertices_`
  std::vector<Vertex> vertices_;
  std::vector<uint32_t> cell_index_;  // of a vertex among those of a cell
  Eigen::AlignedBox3d box_;
};

// Flat regions lose all vertices that they can; the others share the rest in proportion to what they have.
ReducedTriangles Simplified(size_t max_triangles, double error_m, const RawMesh& mesh, const SmoothSurface& surface) {
  const RegionTriangles by_region(surface);
  RegionSimplifier simplifier(mesh, surface);
  ReducedTriangles result;
  size_t curved_before = 0;
  for (uint32_t region = 0; region < surface.regions.size(); ++region) {
    const absl::Span<const uint32_t> triangles = by_region.Of(region);
    if (surface.regions[region].is_flat()) {
      simplifier.Simplify(region, triangles, 0, error_m, result);
    } else {
      curved_before += triangles.size();
    }
  }
  const size_t flat = result.corners.size();
  const double share = max_triangles > flat && curved_before > 0
                           ? std::min(1.0, static_cast<double>(max_triangles - flat) / curved_before)
                           : 0.0;
  for (uint32_t region = 0; region < surface.regions.size(); ++region) {
    if (surface.regions[region].is_flat()) continue;
    const absl::Span<const uint32_t> triangles = by_region.Of(region);
    const size_t target = static_cast<size_t>(share * static_cast<double>(triangles.size()));
    simplifier.Simplify(region, triangles, target, error_m, result);
  }
  return result;
}

// The largest distance of removed vertices, of which at most kErrorSamples are tested, from the triangles. At most
// twice the limit.
double LargestSampledDistance(const RawMesh& mesh, const ReducedTriangles& triangles, double limit_m) {
  std::vector<bool> is_removed(mesh.points.size());
  for (const auto& triangle : mesh.triangles) {
    for (const uint32_t vertex : triangle) is_removed[vertex] = true;
  }
  for (const auto& triangle : triangles.corners) {
    for (const uint32_t vertex : triangle) is_removed[vertex] = false;
  }
  const size_t count = std::count(is_removed.begin(), is_removed.end(), true);
  const size_t step = count / kErrorSamples + 1;
  const TriangleBvh faces(mesh.points, triangles.corners);
  std::vector<TriangleBvh::Near> near;
  double largest_m = 0.0;
  for (size_t point = 0, removed = 0; point < is_removed.size(); ++point) {
    if (!is_removed[point] || removed++ % step != 0) continue;
    double distance_m = 2.0 * limit_m;
    faces.FindNear(mesh.points[point], distance_m, near);
    for (const TriangleBvh::Near& triangle : near) distance_m = std::min(distance_m, triangle.distance_m);
    largest_m = std::max(largest_m, distance_m);
  }
  return largest_m;
}

}  // namespace

Simplification SimplifyMesh(size_t max_triangles, double max_error_m, RawMesh& mesh, SmoothSurface& surface) {
  const size_t before = mesh.triangles.size();
  if (before <= max_triangles) return {before, before, 0.0};
  double limit_m = kLimitOfMean * max_error_m;
  for (int attempt = 0; attempt < kErrorAttempts; ++attempt) {
    ReducedTriangles triangles = Simplified(max_triangles, limit_m, mesh, surface);
    const double error_m = LargestSampledDistance(mesh, triangles, max_error_m);
    if (error_m <= max_error_m) {
      mesh.triangles = std::move(triangles.corners);
      mesh.corner_normals.clear();
      mesh.exact_surface = {};
      surface.region_of = std::move(triangles.surface.region_of);
      surface.normals = std::move(triangles.surface.normals);
      return {before, mesh.triangles.size(), error_m};
    }
    limit_m *= kNextLimit * max_error_m / error_m;
  }
  return {before, before, 0.0};
}

}  // namespace evpose
