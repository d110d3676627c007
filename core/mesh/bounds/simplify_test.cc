// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/simplify.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "core/mesh/surface_patch_testing.h"

namespace evpose {
namespace {

using Edge = std::array<uint32_t, 2>;

// The edges between regions and those with one triangle.
std::set<Edge> BorderEdges(const SurfacePatch& patch) {
  std::map<Edge, std::vector<uint32_t>> regions;
  for (size_t t = 0; t < patch.mesh.triangles.size(); ++t) {
    for (int side = 0; side < 3; ++side) {
      const uint32_t a = patch.mesh.triangles[t][side], b = patch.mesh.triangles[t][(side + 1) % 3];
      regions[{std::min(a, b), std::max(a, b)}].push_back(patch.surface.region_of[t]);
    }
  }
  std::set<Edge> borders;
  for (const auto& [edge, beside] : regions) {
    if (beside.size() != 2 || beside[0] != beside[1]) borders.insert(edge);
  }
  return borders;
}

bool HasEdge(const RawMesh& mesh, const Edge& edge) {
  return std::any_of(mesh.triangles.begin(), mesh.triangles.end(), [&](const auto& t) {
    return std::count(t.begin(), t.end(), edge[0]) > 0 && std::count(t.begin(), t.end(), edge[1]) > 0;
  });
}

// A band of the unit sphere with its exact normals.
SurfacePatch SphereBand(uint32_t sides) {
  SurfacePatch patch = GridPatch({.u = sides, .v = sides / 2, .wraps_u = true}, [](double u, double v) {
    const double latitude = 2.5 * (v - 0.5);
    return Eigen::Vector3d(std::cos(latitude) * OnCircle(u) + std::sin(latitude) * Eigen::Vector3d::UnitZ());
  });
  for (size_t t = 0; t < patch.mesh.triangles.size(); ++t) {
    for (int corner = 0; corner < 3; ++corner) {
      patch.surface.normals[t][corner] = patch.mesh.points[patch.mesh.triangles[t][corner]].cast<float>();
    }
  }
  return patch;
}

// A dense square, of which one half is region 1 if `is_split`. Flat, or bent to a paraboloid.
SurfacePatch Square(uint32_t cells, bool is_split, double height_m) {
  SurfacePatch patch = GridPatch({.u = cells, .v = cells}, [&](double u, double v) -> Eigen::Vector3d {
    return {u, v, height_m * 4.0 * (u * (1.0 - u) + v * (1.0 - v))};
  });
  SurfaceRegion region;
  if (height_m == 0.0) region.shape = RegionShape::kPlane;
  region.axis = Eigen::Vector3d::UnitZ();
  patch.surface.regions = {region};
  if (!is_split) return patch;
  patch.surface.regions.push_back(region);
  for (size_t t = 0; t < patch.mesh.triangles.size(); ++t) {
    double x = 0.0;
    for (const uint32_t vertex : patch.mesh.triangles[t]) x += patch.mesh.points[vertex].x() / 3.0;
    patch.surface.region_of[t] = x > 0.5 ? 1 : 0;
  }
  return patch;
}

// Largest distance from the unit sphere over points of the triangles.
double SphereError(const RawMesh& mesh) {
  double largest = 0.0;
  for (const auto& [a, b, c] : mesh.triangles) {
    for (int i = 0; i <= 4; ++i) {
      for (int j = 0; i + j <= 4; ++j) {
        const Eigen::Vector3d point = (i * mesh.points[a] + j * mesh.points[b] + (4 - i - j) * mesh.points[c]) / 4.0;
        largest = std::max(largest, std::abs(point.norm() - 1.0));
      }
    }
  }
  return largest;
}

TEST(SimplifyMeshTest, SmallMeshIsKept) {
  SurfacePatch patch = SphereBand(16);
  const auto before = patch.mesh.triangles;
  const Simplification result = SimplifyMesh(before.size(), 0.1, patch.mesh, patch.surface);
  EXPECT_EQ(result.triangles_after, before.size());
  EXPECT_EQ(result.error_m, 0.0);
  EXPECT_EQ(patch.mesh.triangles, before);
}

TEST(SimplifyMeshTest, ApproachesTheNumberOfTrianglesWithinTheError) {
  SurfacePatch patch = SphereBand(160);
  const std::set<Edge> borders = BorderEdges(patch);
  const size_t before = patch.mesh.triangles.size();
  const Simplification result = SimplifyMesh(before / 8, 5e-3, patch.mesh, patch.surface);
  EXPECT_EQ(result.triangles_before, before);
  EXPECT_LE(result.triangles_after, before / 6);
  EXPECT_GT(result.triangles_after, before / 16);
  EXPECT_EQ(result.triangles_after, patch.mesh.triangles.size());
  EXPECT_LE(result.error_m, 5e-3);
  EXPECT_LE(SphereError(patch.mesh), 5e-3);
  EXPECT_EQ(BorderEdges(patch), borders);
}

TEST(SimplifyMeshTest, StopsAtTheError) {
  SurfacePatch patch = SphereBand(160);
  const size_t before = patch.mesh.triangles.size();
  const Simplification result = SimplifyMesh(1, 1e-3, patch.mesh, patch.surface);
  EXPECT_LT(result.triangles_after, before);
  EXPECT_GT(result.triangles_after, 1000u);
  EXPECT_GT(result.error_m, 0.0);
  EXPECT_LE(result.error_m, 1e-3);
  EXPECT_LE(SphereError(patch.mesh), 2e-3);
}

TEST(SimplifyMeshTest, NormalsAreThoseOfTheVertices) {
  SurfacePatch patch = SphereBand(96);
  SimplifyMesh(patch.mesh.triangles.size() / 4, 1e-2, patch.mesh, patch.surface);
  ASSERT_EQ(patch.surface.normals.size(), patch.mesh.triangles.size());
  ASSERT_EQ(patch.surface.region_of.size(), patch.mesh.triangles.size());
  double area = 0.0, inclined = 0.0;
  for (size_t t = 0; t < patch.mesh.triangles.size(); ++t) {
    const auto& [i, j, k] = patch.mesh.triangles[t];
    const std::vector<Eigen::Vector3d>& p = patch.mesh.points;
    const Eigen::Vector3d cross = (p[j] - p[i]).cross(p[k] - p[i]);
    area += cross.norm();
    for (int corner = 0; corner < 3; ++corner) {
      const Eigen::Vector3f& normal = patch.surface.normals[t][corner];
      EXPECT_EQ(normal, p[patch.mesh.triangles[t][corner]].cast<float>());
      if (cross.dot(normal.cast<double>()) < 0.8 * cross.norm()) inclined += cross.norm() / 3.0;
    }
  }
  EXPECT_LT(inclined, 0.01 * area);  // slivers
}

TEST(SimplifyMeshTest, FlatRegionsKeepOnlyTheirBorders) {
  SurfacePatch patch = Square(64, true, 0.0);
  const std::set<Edge> borders = BorderEdges(patch);
  const Simplification result = SimplifyMesh(100, 1e-3, patch.mesh, patch.surface);
  // Two triangulated polygons with `corners` vertices have corners - 2 triangles each.
  EXPECT_LT(result.triangles_after, 2 * borders.size());
  EXPECT_LT(result.error_m, 1e-9);
  std::array<double, 2> areas = {0.0, 0.0};
  for (size_t t = 0; t < patch.mesh.triangles.size(); ++t) {
    const auto& [i, j, k] = patch.mesh.triangles[t];
    const std::vector<Eigen::Vector3d>& p = patch.mesh.points;
    const double twice_area = (p[j] - p[i]).cross(p[k] - p[i]).z();
    EXPECT_GT(twice_area, 0.0);
    areas[patch.surface.region_of[t]] += 0.5 * twice_area;
  }
  EXPECT_NEAR(areas[0], 0.5, 1e-12);
  EXPECT_NEAR(areas[1], 0.5, 1e-12);
}

TEST(SimplifyMeshTest, BorderBetweenCurvedRegionsStays) {
  SurfacePatch patch = Square(64, true, 0.1);
  const std::set<Edge> borders = BorderEdges(patch);
  const Simplification result = SimplifyMesh(2000, 1e-2, patch.mesh, patch.surface);
  EXPECT_LE(result.triangles_after, 2500u);
  const std::set<Edge> after = BorderEdges(patch);
  EXPECT_TRUE(std::includes(after.begin(), after.end(), borders.begin(), borders.end()));
}

TEST(SimplifyMeshTest, CreaseInsideARegionStays) {
  constexpr uint32_t kCells = 64;
  SurfacePatch patch = Square(kCells, false, 0.1);
  // The crease is in the column u = 1/2, from v = 1/4 to 3/4; its normals differ on both sides.
  std::vector<Edge> crease;
  for (uint32_t v = kCells / 4; v < 3 * kCells / 4; ++v) {
    const uint32_t first = v * (kCells + 1) + kCells / 2;
    crease.push_back({first, first + kCells + 1});
  }
  for (size_t t = 0; t < patch.mesh.triangles.size(); ++t) {
    for (int corner = 0; corner < 3; ++corner) {
      const uint32_t vertex = patch.mesh.triangles[t][corner];
      if (vertex <= crease.front()[0] || vertex >= crease.back()[1] || vertex % (kCells + 1) != kCells / 2) continue;
      const bool is_left = t / 2 % kCells < kCells / 2;
      Eigen::Vector3f& normal = patch.surface.normals[t][corner];
      normal = (normal + Eigen::Vector3f(is_left ? -0.3f : 0.3f, 0.0f, 0.0f)).normalized();
    }
  }
  const Simplification result = SimplifyMesh(2000, 1e-2, patch.mesh, patch.surface);
  EXPECT_LE(result.triangles_after, 2500u);
  for (const Edge& edge : crease) EXPECT_TRUE(HasEdge(patch.mesh, edge)) << edge[0];
}

// The time of the simplification is quadratic in the number of triangles at a vertex.
TEST(SimplifyMeshTest, TrianglesAtACrowdedVertexStay) {
  constexpr uint32_t kSides = 1000;
  SurfacePatch patch;
  patch.mesh.points.push_back(Eigen::Vector3d::Zero());
  for (uint32_t i = 0; i < kSides; ++i) patch.mesh.points.push_back(OnCircle(static_cast<double>(i) / kSides));
  for (uint32_t i = 0; i < kSides; ++i) patch.mesh.triangles.push_back({0, 1 + i, 1 + (i + 1) % kSides});
  SetMeanNormals(patch);
  const auto before = patch.mesh.triangles;
  SimplifyMesh(10, 1e-3, patch.mesh, patch.surface);
  EXPECT_EQ(patch.mesh.triangles, before);
}

TEST(SimplifyMeshTest, FacesOfTheFileAreForgotten) {
  SurfacePatch patch = SphereBand(32);
  patch.mesh.corner_normals = patch.surface.normals;
  patch.mesh.exact_surface = patch.surface;
  SimplifyMesh(patch.mesh.triangles.size() / 2, 0.1, patch.mesh, patch.surface);
  EXPECT_TRUE(patch.mesh.corner_normals.empty());
  EXPECT_TRUE(patch.mesh.exact_surface.empty());
}

}  // namespace
}  // namespace evpose
