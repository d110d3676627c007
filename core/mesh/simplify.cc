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
// meshopt_simplify limits a mean distance over the planes of the triangles removed, which the largest exceeds. Limits
// of the mean to be tried in a cell, relative to the largest distance allowed.
constexpr std::array<double, 4> kLimitsOfMean = {1.0, 0.5, 0.2, 0.08};
// Attempts for the whole mesh, each with smaller limits.
constexpr int kErrorAttempts = 2;
constexpr double kNextLimit = 0.8;  // limit of the next attempt, times allowed / largest distance
// Removed vertices whose distance from the result is measured: bounds the time, at a few per mille of a dense mesh.
constexpr size_t kErrorSamples = 4096;
// Height of a triangle relative to its longest side below which it is a line.
constexpr double kMinReducedHeight = 1e-7;

// meshopt_simplify sums squares of coordinates in single precision, so that it does not resolve distances below some
// 3e-4 of the size of its input. Regions are therefore reduced cell by cell: so many triangles on average, and so many
// cells along the longest axis at most.
constexpr double kTrianglesPerCell = 2000.0, kMaxCells = 16.0;
// Shifts of the cells in the passes: vertices at the borders of the cells of a pass are within cells of the next.
constexpr double kShifts[] = {0.0, 0.5, 0.25, 0.75};
// A pass that removes less is the last one.
constexpr double kWorthwhileShare = 0.05;
// Coordinates of cells are in [1, kMaxCells + 2], so that the neighbours of a cell have numbers of their own.
constexpr uint32_t kCellStride = 32;

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

  // `indices` of `vertices_`, three for each triangle.
  void Reduce(size_t target, double error_m, std::vector<uint32_t>& indices) {
    cell_index_.assign(vertices_.size(), kNotCollected);
    is_corner_.assign(vertices_.size(), false);
    removed_.clear();
    first_limit_ = 0;
    for (const double shift : kShifts) {
      const size_t before = indices.size();
      if (before <= 3 * target || !(box_.sizes().maxCoeff() > 0.0)) return;
      ReduceCells(target, shift, error_m, indices);
      if (static_cast<double>(indices.size()) > (1.0 - kWorthwhileShare) * static_cast<double>(before)) return;
    }
  }

  using CellEntry = std::pair<uint32_t, uint32_t>;  // cell, and a triangle or a vertex

  void ReduceCells(size_t target, double shift, double error_m, std::vector<uint32_t>& indices) {
    const size_t count = indices.size() / 3;
    const double cells = std::floor(std::sqrt(static_cast<double>(count) / kTrianglesPerCell));
    const double cells_per_m = std::clamp(cells, 1.0, kMaxCells) / box_.sizes().maxCoeff();
    const auto cell_of = [&](const Eigen::Vector3d& point) {
      const Eigen::Array3d cell = (point - box_.min()).array() * cells_per_m + (shift + 1.0);
      return (static_cast<uint32_t>(cell.x()) * kCellStride + static_cast<uint32_t>(cell.y())) * kCellStride +
             static_cast<uint32_t>(cell.z());
    };
    std::vector<CellEntry> order, removed;
    order.reserve(count);
    for (uint32_t t = 0; t < count; ++t) {
      Eigen::Vector3d centroid = Eigen::Vector3d::Zero();
      for (int corner = 0; corner < 3; ++corner) centroid += PointOf(indices[3 * t + corner]) / 3.0;
      order.emplace_back(cell_of(centroid), t);
    }
    std::sort(order.begin(), order.end());
    for (const uint32_t vertex : removed_) removed.emplace_back(cell_of(PointOf(vertex)), vertex);
    std::sort(removed.begin(), removed.end());
    const double share = static_cast<double>(target) / static_cast<double>(count);
    std::vector<uint32_t> reduced, of_cell;
    for (size_t i = 0; i < count; ++i) {
      const auto [cell, triangle] = order[i];
      const size_t t = triangle;
      of_cell.insert(of_cell.end(), {indices[3 * t], indices[3 * t + 1], indices[3 * t + 2]});
      if (i + 1 < count && order[i + 1].first == cell) continue;
      const size_t num_triangles = of_cell.size() / 3;
      ReduceCell(static_cast<size_t>(share * static_cast<double>(num_triangles)), error_m, RemovedAround(cell, removed),
                 of_cell);
      reduced.insert(reduced.end(), of_cell.begin(), of_cell.end());
      of_cell.clear();
    }
    indices = std::move(reduced);
  }

  const Eigen::Vector3d& PointOf(uint32_t vertex) const { return mesh_.points[vertices_[vertex].point]; }

  // Vertices that earlier passes have removed in a cell and its neighbours.
  static std::vector<uint32_t> RemovedAround(uint32_t cell, const std::vector<CellEntry>& removed) {
    std::vector<uint32_t> around;
    if (removed.empty()) return around;
    for (uint32_t neighbour = 0; neighbour < 9; ++neighbour) {
      // Three cells along z have successive numbers.
      const uint32_t first =
          cell + (neighbour / 3 * kCellStride + neighbour % 3) * kCellStride - (kCellStride + 1) * kCellStride - 1;
      auto entry = std::lower_bound(removed.begin(), removed.end(), CellEntry(first, 0));
      for (; entry != removed.end() && entry->first <= first + 2; ++entry) around.push_back(entry->second);
    }
    return around;
  }

  // Reduces the triangles of a cell. All of their vertices, and those of `removed_around` that are near to them, stay
  // within `error_m` of them.
  void ReduceCell(size_t target, double error_m, const std::vector<uint32_t>& removed_around,
                  std::vector<uint32_t>& indices) {
    if (indices.size() <= 3 * target) return;
    std::vector<uint32_t> vertices;
    Eigen::AlignedBox3d box;
    std::vector<uint32_t> local = indices;
    for (uint32_t& index : local) {
      if (cell_index_[index] == kNotCollected) {
        cell_index_[index] = static_cast<uint32_t>(vertices.size());
        vertices.push_back(index);
        box.extend(PointOf(index));
      }
      index = cell_index_[index];
    }
    for (const uint32_t vertex : vertices) cell_index_[vertex] = kNotCollected;
    const double extent_m = box.sizes().maxCoeff();
    if (!(extent_m > 0.0)) return;
    std::vector<float> positions;
    positions.reserve(3 * vertices.size());
    for (const uint32_t vertex : vertices) {
      const Eigen::Vector3f position = ((PointOf(vertex) - box.min()) / extent_m).cast<float>();
      positions.insert(positions.end(), {position.x(), position.y(), position.z()});
    }
    const std::vector<uint32_t> watched = Watched(removed_around, box, error_m, indices);
    std::vector<uint32_t> reduced(local.size());
    // Neighbouring cells are similar.
    if (first_limit_ > 0) --first_limit_;
    for (; first_limit_ < kLimitsOfMean.size(); ++first_limit_) {
      const double limit_m = kLimitsOfMean[first_limit_] * error_m;
      reduced.resize(local.size());
      reduced.resize(meshopt_simplify(reduced.data(), local.data(), local.size(), positions.data(), vertices.size(),
                                      3 * sizeof(float), 3 * target, static_cast<float>(limit_m / extent_m),
                                      meshopt_SimplifyLockBorder, nullptr));
      if (reduced.size() == local.size()) return;
      for (uint32_t& index : reduced) index = vertices[index];
      if (AreNear(vertices, watched, error_m, reduced)) {
        std::swap(indices, reduced);
        AddRemoved(vertices, indices);
        return;
      }
    }
  }

  TriangleBvh TreeOf(const std::vector<uint32_t>& indices) const {
    std::vector<std::array<uint32_t, 3>> triangles;
    triangles.reserve(indices.size() / 3);
    for (size_t i = 0; i < indices.size(); i += 3) {
      triangles.push_back(
          {vertices_[indices[i]].point, vertices_[indices[i + 1]].point, vertices_[indices[i + 2]].point});
    }
    return TriangleBvh(mesh_.points, triangles);
  }

  // Whether triangles of about the same direction are near to a vertex. `hint`: see TriangleBvh::HasNear().
  bool IsNear(const TriangleBvh& tree, uint32_t vertex, double distance_m, uint32_t& hint) const {
    return tree.HasNear(PointOf(vertex), distance_m, vertices_[vertex].normal.cast<double>(), 0.0, hint);
  }

  std::vector<uint32_t> Watched(const std::vector<uint32_t>& removed_around, const Eigen::AlignedBox3d& box,
                                double error_m, const std::vector<uint32_t>& indices) const {
    std::vector<uint32_t> watched;
    for (const uint32_t vertex : removed_around) {
      if (box.squaredExteriorDistance(PointOf(vertex)) <= error_m * error_m) watched.push_back(vertex);
    }
    if (watched.empty()) return watched;
    const TriangleBvh tree = TreeOf(indices);
    uint32_t hint = 0;
    std::erase_if(watched, [&](uint32_t vertex) { return !IsNear(tree, vertex, error_m, hint); });
    return watched;
  }

  bool AreNear(const std::vector<uint32_t>& vertices, const std::vector<uint32_t>& watched, double error_m,
               const std::vector<uint32_t>& indices) {
    const TriangleBvh tree = TreeOf(indices);
    MarkCorners(indices);
    uint32_t hint = 0;
    const auto is_near = [&](uint32_t vertex) { return is_corner_[vertex] || IsNear(tree, vertex, error_m, hint); };
    const bool are_near =
        std::all_of(vertices.begin(), vertices.end(), is_near) && std::all_of(watched.begin(), watched.end(), is_near);
    for (const uint32_t index : indices) is_corner_[index] = false;
    return are_near;
  }

  // Marks the vertices that are corners of a triangle of about their direction: these need no search.
  void MarkCorners(const std::vector<uint32_t>& indices) {
    for (size_t i = 0; i < indices.size(); i += 3) {
      const Eigen::Vector3d& a = PointOf(indices[i]);
      const Eigen::Vector3d normal = (PointOf(indices[i + 1]) - a).cross(PointOf(indices[i + 2]) - a);
      for (size_t corner = i; corner < i + 3; ++corner) {
        const uint32_t vertex = indices[corner];
        if (normal.dot(vertices_[vertex].normal.cast<double>()) > 0.0) is_corner_[vertex] = true;
      }
    }
  }

  void AddRemoved(const std::vector<uint32_t>& vertices, const std::vector<uint32_t>& indices) {
    for (const uint32_t index : indices) cell_index_[index] = 0;
    for (const uint32_t vertex : vertices) {
      if (cell_index_[vertex] == kNotCollected) removed_.push_back(vertex);
    }
    for (const uint32_t index : indices) cell_index_[index] = kNotCollected;
  }

  const RawMesh& mesh_;
  const SmoothSurface& surface_;
  std::vector<uint32_t> index_;  // index of a point in `vertices_`
  std::vector<Vertex> vertices_;
  std::vector<uint32_t> cell_index_;  // index of a vertex among those of a cell
  std::vector<bool> is_corner_;       // vertices that MarkCorners() has marked; none outside of AreNear()
  std::vector<uint32_t> removed_;     // vertices of the region, in all passes so far
  size_t first_limit_ = 0;            // index in kLimitsOfMean with which the last cell succeeded
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
  double limit_m = max_error_m;
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
