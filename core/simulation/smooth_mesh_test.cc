// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/smooth_mesh.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace evpose {
namespace {

using Eigen::Vector3d;

constexpr double kNoLimit = std::numeric_limits<double>::infinity();

// A cylinder of radius 1 and height 2 with the exact normals of its wall and plane covers.
SmoothMesh RoundCylinder(int sides) {
  SmoothMesh mesh;
  for (int i = 0; i < sides; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / sides;
    mesh.points.emplace_back(std::cos(angle), std::sin(angle), -1.0);
    mesh.points.emplace_back(std::cos(angle), std::sin(angle), 1.0);
  }
  mesh.points.emplace_back(0.0, 0.0, -1.0);
  mesh.points.emplace_back(0.0, 0.0, 1.0);
  const auto wall_normal = [&](uint32_t point) {
    return Vector3d(mesh.points[point].x(), mesh.points[point].y(), 0.0);
  };
  const auto add = [&](std::array<uint32_t, 3> corners, const Vector3d& cover_normal) {
    mesh.triangles.push_back(corners);
    auto& normals = mesh.normals.emplace_back();
    for (int k = 0; k < 3; ++k) normals[k] = cover_normal.isZero() ? wall_normal(corners[k]) : cover_normal;
  };
  const auto count = static_cast<uint32_t>(2 * sides);
  for (uint32_t i = 0; i < count; i += 2) {
    const uint32_t next = (i + 2) % count;
    add({i, next, next + 1}, Vector3d::Zero());
    add({i, next + 1, i + 1}, Vector3d::Zero());
    add({count, next, i}, -Vector3d::UnitZ());
    add({count + 1, i + 1, next + 1}, Vector3d::UnitZ());
  }
  return mesh;
}

double LargestMiddleDistance(const SmoothMesh& mesh) {
  double largest = 0.0;
  for (const auto& triangle : mesh.triangles) {
    for (int k = 0; k < 3; ++k) {
      const Vector3d& a = mesh.points[triangle[k]];
      const Vector3d& b = mesh.points[triangle[(k + 1) % 3]];
      if (std::abs(a.head<2>().norm() - 1.0) > 1e-6 || std::abs(b.head<2>().norm() - 1.0) > 1e-6) continue;
      largest = std::max(largest, 1.0 - (0.5 * (a + b)).head<2>().norm());
    }
  }
  return largest;
}

TEST(SmoothMeshTest, CylinderKeepsItsRadiusAndItsPlaneCovers) {
  SmoothMesh mesh = RoundCylinder(12);
  ASSERT_TRUE(IsClosed(mesh));
  ASSERT_GT(LargestMiddleDistance(mesh), 0.03);
  Subdivide(1e-4, kNoLimit, mesh);
  EXPECT_LE(LargestMiddleDistance(mesh), 1e-4 * (1.0 + 1e-6));
  EXPECT_TRUE(IsClosed(mesh)) << "the wall and the covers must share the points of the rims";
  for (const Vector3d& point : mesh.points) {
    EXPECT_LE(point.head<2>().norm(), 1.0 + 1e-9);
    if (std::abs(point.z()) < 1.0) {
      EXPECT_NEAR(point.head<2>().norm(), 1.0, 1e-9) << point.transpose();
    }
  }
}

TEST(SmoothMeshTest, PlaneFacesAreDividedForTheLengthOfTheirEdgesOnly) {
  SmoothMesh mesh = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{0, 1, 2}}, {}};
  mesh.normals.resize(1);
  mesh.normals[0].fill(Vector3d::UnitZ());
  EXPECT_FALSE(IsClosed(mesh));
  Subdivide(1e-9, kNoLimit, mesh);
  EXPECT_EQ(mesh.triangles.size(), 1u);
  Subdivide(1e-9, 0.3, mesh);
  double area = 0.0;
  for (const auto& [a, b, c] : mesh.triangles) {
    const Vector3d normal = (mesh.points[b] - mesh.points[a]).cross(mesh.points[c] - mesh.points[a]);
    EXPECT_GT(normal.z(), 0.0);
    area += 0.5 * normal.z();
    EXPECT_LE((mesh.points[b] - mesh.points[a]).norm(), 0.3);
  }
  EXPECT_NEAR(area, 0.5, 1e-12);
}

TEST(SmoothMeshTest, ModelsWithoutSmoothSurfaceHaveTheNormalsOfTheirFaces) {
  ObjectModel model;
  model.vertices = {{0, 0, 0}, {2, 0, 0}, {0, 2, 0}, {0, 0, 2}};
  model.triangles = {{0, 1, 2}, {0, 1, 3}};
  const SmoothMesh mesh = MakeSmoothMesh(model);
  EXPECT_EQ(mesh.normals[0][2], Vector3d::UnitZ());
  EXPECT_EQ(mesh.normals[1][0], -Vector3d::UnitY());
}

TEST(SmoothMeshTest, CurvedRegionsHaveTheNormalsOfTheSurface) {
  ObjectModel model;
  model.vertices = {{0, 0, 0}, {2, 0, 0}, {0, 2, 0}};
  model.triangles = {{0, 1, 2}};
  model.surface.region_of = {0};
  model.surface.regions = {SurfaceRegion()};
  model.surface.normals.resize(1);
  model.surface.normals[0].fill(Eigen::Vector3f(0.0f, 0.6f, 0.8f));
  EXPECT_NEAR(MakeSmoothMesh(model).normals[0][1].y(), 0.6, 1e-6);
  model.surface.regions[0].shape = RegionShape::kPlane;
  EXPECT_EQ(MakeSmoothMesh(model).normals[0][1], Vector3d::UnitZ());
}

TEST(SmoothMeshTest, ALineOnTheBorderOfASheetHasNoStrip) {
  ObjectModel sheet;
  sheet.vertices = {{-0.1, -0.1, 0}, {0.1, -0.1, 0}, {0.1, 0.1, 0}, {-0.1, 0.1, 0}};
  sheet.triangles = {{0, 1, 2}, {0, 2, 3}};
  sheet.diameter_m = 0.28;
  const auto strips_at = [&](double y) {
    sheet.lines = {{{-0.05, y, 0}, {0.05, y, 0}, {Vector3d::UnitZ()}, EdgeKind::kPainted}};
    return PaintedStrips(sheet, 0.002, 1.0).triangles.size();
  };
  EXPECT_EQ(strips_at(0.0), 2u);
  EXPECT_EQ(strips_at(0.098), 2u);
  EXPECT_EQ(strips_at(0.1), 0u);
  EXPECT_EQ(strips_at(-0.1), 0u);
}

}  // namespace
}  // namespace evpose
