// SPDX-License-Identifier: Apache-2.0
#include "core/models/display_geometry.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace evpose {
namespace {

// A sphere of radius 0.1 m: `rows` x 2 `rows` quadrilaterals without their corners at the poles.
ObjectModel DisplaySphere(int rows) {
  ObjectModel model;
  const int columns = 2 * rows;
  for (int row = 0; row <= rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const double polar = M_PI * (0.001 + 0.998 * row / rows), around = 2.0 * M_PI * column / columns;
      model.vertices.push_back(0.1 * Eigen::Vector3d(std::sin(polar) * std::cos(around),
                                                     std::sin(polar) * std::sin(around), std::cos(polar)));
    }
  }
  const auto index = [columns](int row, int column) { return static_cast<uint32_t>(row * columns + column % columns); };
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      model.triangles.push_back({index(row, column), index(row + 1, column), index(row + 1, column + 1)});
      model.triangles.push_back({index(row, column), index(row + 1, column + 1), index(row, column + 1)});
    }
  }
  return model;
}

// Each triangle by itself.
ObjectModel Soup(size_t count) {
  ObjectModel model;
  for (size_t i = 0; i < count; ++i) {
    const size_t column = i % 300, row = i / 300;
    const double x = 1e-3 * static_cast<double>(column), y = 1e-3 * static_cast<double>(row);
    const auto first = static_cast<uint32_t>(model.vertices.size());
    model.vertices.insert(model.vertices.end(), {{x, y, 0}, {x + 5e-4, y, 0}, {x, y + 5e-4, 0}});
    model.triangles.push_back({first, first + 1, first + 2});
  }
  return model;
}

void ExpectConsistent(const DisplayGeometry& geometry) {
  std::vector<bool> is_used(geometry.vertices.size());
  for (const auto& face : geometry.faces) {
    for (const uint32_t vertex : face) {
      ASSERT_LT(vertex, geometry.vertices.size());
      is_used[vertex] = true;
    }
  }
  EXPECT_EQ(std::count(is_used.begin(), is_used.end(), false), 0);
}

TEST(DisplayGeometryTest, ASmallModelStaysAsItIs) {
  ObjectModel model;
  model.vertices = {{0, 0, 0}, {9, 9, 9}, {1, 0, 0}, {0, 1, 0}};  // one is unused
  model.triangles = {{0, 2, 3}};
  model.lines = {{{0, 0, 0}, {1, 0, 0}, {}, EdgeKind::kBoundary}};
  model.curves = {{EdgeKind::kCrease, {{1, 0, 0}, {0.7, 0.7, 0}, {0, 1, 0}}, {}, 0.0}};
  const DisplayGeometry geometry = MakeDisplayGeometry(model, {});
  EXPECT_FALSE(geometry.is_simplified);
  ASSERT_EQ(geometry.vertices.size(), 3u);
  EXPECT_EQ(geometry.vertices[1], Eigen::Vector3f(1, 0, 0));
  EXPECT_EQ(geometry.faces, (std::vector<std::array<uint32_t, 3>>{{0, 1, 2}}));
  ASSERT_EQ(geometry.edges.size(), 3u);
  EXPECT_EQ(geometry.edges[0][1], Eigen::Vector3f(1, 0, 0));
  EXPECT_EQ(geometry.edges[1][1], Eigen::Vector3f(0.7f, 0.7f, 0));
  EXPECT_EQ(geometry.edges[2][1], Eigen::Vector3f(0, 1, 0));
}

TEST(DisplayGeometryTest, ReducesADenseMeshNearItsSurface) {
  const ObjectModel sphere = DisplaySphere(100);
  ASSERT_EQ(sphere.triangles.size(), 40'000u);
  for (const size_t max_faces : {1000u, 20'000u}) {
    const DisplayGeometry geometry = MakeDisplayGeometry(sphere, {.max_faces = max_faces});
    EXPECT_TRUE(geometry.is_simplified);
    EXPECT_LE(geometry.faces.size(), max_faces * 11 / 10);
    EXPECT_GE(geometry.faces.size(), max_faces / 2);
    ExpectConsistent(geometry);
    for (const auto& face : geometry.faces) {
      const Eigen::Vector3f middle =
          (geometry.vertices[face[0]] + geometry.vertices[face[1]] + geometry.vertices[face[2]]) / 3.0f;
      EXPECT_NEAR(middle.norm(), 0.1f, 0.005f);
    }
  }
}

// At one vertex as many triangles meet as make the reduction along the surface slow.
TEST(DisplayGeometryTest, ReducesAFanInAGrid) {
  ObjectModel fan;
  constexpr uint32_t kCount = 30'000;
  fan.vertices.push_back({0, 0, 0.1});
  for (uint32_t i = 0; i < kCount; ++i) {
    const double angle = 2.0 * M_PI * i / kCount;
    fan.vertices.push_back({std::cos(angle), std::sin(angle), 0});
    fan.triangles.push_back({0, i + 1, (i + 1) % kCount + 1});
  }
  const DisplayGeometry geometry = MakeDisplayGeometry(fan, {.max_faces = 500});
  EXPECT_TRUE(geometry.is_simplified);
  EXPECT_LE(geometry.faces.size(), 500u);
  EXPECT_GT(geometry.faces.size(), 0u);
  ExpectConsistent(geometry);
}

TEST(DisplayGeometryTest, BoundsItsBytes) {
  ObjectModel model = Soup(99'000);
  for (int i = 0; i < 60'000; ++i) {
    model.lines.push_back({{0, 0, 0}, {1.0 + i, 0, 0}, {}, EdgeKind::kCrease});
  }
  const DisplayGeometry geometry = MakeDisplayGeometry(model, {.max_faces = 100'000});
  EXPECT_TRUE(geometry.is_simplified);
  EXPECT_GT(geometry.faces.size(), 1000u);
  // A vertex and a face have three numbers of four bytes, an edge six.
  EXPECT_LT(12 * (geometry.vertices.size() + geometry.faces.size()) + 24 * geometry.edges.size(), 3'800'000u);
  ExpectConsistent(geometry);
  ASSERT_EQ(geometry.edges.size(), 50'000u);
  for (const auto& [p1, p2] : geometry.edges) EXPECT_GT(p2.x(), 10'000.0f) << "the longest ones stay";
}

}  // namespace
}  // namespace evpose
