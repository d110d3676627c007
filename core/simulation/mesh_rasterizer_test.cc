// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/mesh_rasterizer.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <vector>

namespace evpose {
namespace {

class MeshRasterizerTest : public testing::Test {
 protected:
  static constexpr int kWidth = 40;
  static constexpr PixelRect kImage = {0, 0, kWidth, 30};

  static ScreenVertex At(double x, double y, float depth_m, float light) { return {{x, y}, 1.0f / depth_m, light}; }
  // Adds a triangle with its three edges.
  void Add(const ScreenVertex& a, const ScreenVertex& b, const ScreenVertex& c) {
    AddSmooth(a, b, c);
    const std::array<uint32_t, 3>& corners = triangles_.back();
    for (int k = 0; k < 3; ++k) edges_.push_back({corners[k], corners[(k + 1) % 3]});
  }
  void AddSmooth(const ScreenVertex& a, const ScreenVertex& b, const ScreenVertex& c) {
    const auto first = static_cast<uint32_t>(vertices_.size());
    vertices_.insert(vertices_.end(), {a, b, c});
    triangles_.push_back({first, first + 1, first + 2});
  }
  void Clear() {
    vertices_.clear();
    triangles_.clear();
    edges_.clear();
  }
  std::vector<float> Picture() {
    rasterizer_.Render(kImage, {vertices_, triangles_, edges_});
    std::vector<float> picture(static_cast<size_t>(kWidth) * kImage.y1, 0.0f);
    rasterizer_.CompositeOnto(kWidth, picture);
    return picture;
  }
  static double Sum(const std::vector<float>& picture) { return std::accumulate(picture.begin(), picture.end(), 0.0); }

  MeshRasterizer rasterizer_;
  std::vector<ScreenVertex> vertices_;
  std::vector<std::array<uint32_t, 3>> triangles_;
  std::vector<std::array<uint32_t, 2>> edges_;
};

TEST_F(MeshRasterizerTest, CoversTheAreaOfTheTriangle) {
  Add(At(3.2, 4.7, 1, 1), At(31.4, 8.1, 1, 1), At(12.9, 27.3, 1, 1));
  const double area = 0.5 * ((31.4 - 3.2) * (27.3 - 4.7) - (8.1 - 4.7) * (12.9 - 3.2));
  EXPECT_NEAR(Sum(Picture()), area, 0.005 * area);
}

TEST_F(MeshRasterizerTest, EdgeAlongColumnMovesInSixteenSteps) {
  std::vector<double> sums;
  for (int i = 0; i <= 16; ++i) {
    Clear();
    const double right = 20.5 + i / 16.0;
    Add(At(10.5, 5.5, 1, 1), At(right, 5.5, 1, 1), At(right, 15.5, 1, 1));
    Add(At(10.5, 5.5, 1, 1), At(right, 15.5, 1, 1), At(10.5, 15.5, 1, 1));
    sums.push_back(Sum(Picture()));
  }
  for (int i = 0; i <= 16; ++i) EXPECT_NEAR(sums[i], 100.0 + 10.0 * i / 16.0, 1e-3) << i;
}

TEST_F(MeshRasterizerTest, NearerTriangleHidesFartherOneInAnyOrder) {
  const auto draw = [&](float depth_m, float light) {
    Add(At(5, 5, depth_m, light), At(30, 5, depth_m, light), At(5, 25, depth_m, light));
  };
  draw(2.0f, 0.3f);
  draw(1.0f, 0.7f);
  const std::vector<float> near_last = Picture();
  Clear();
  draw(1.0f, 0.7f);
  draw(2.0f, 0.3f);
  EXPECT_EQ(Picture(), near_last);
  EXPECT_FLOAT_EQ(near_last[10 * kWidth + 10], 0.7f);
}

TEST_F(MeshRasterizerTest, LightIsLinearBetweenTheCorners) {
  Add(At(-10, -10, 1, 0.0f), At(90, -10, 1, 1.0f), At(-10, 90, 1, 0.0f));
  const std::vector<float> picture = Picture();
  EXPECT_NEAR(picture[5 * kWidth + 15], 0.25, 1e-5);
  EXPECT_NEAR(picture[25 * kWidth + 30], 0.40, 1e-5);
}

TEST_F(MeshRasterizerTest, NeighboursLeaveNoGap) {
  // A fan about a point: its triangles cover the same area as its outline.
  const int sides = 37;
  for (int i = 0; i < sides; ++i) {
    const auto corner = [&](int k) {
      return At(20.0 + 12.0 * std::cos(k * 6.2831853 / sides), 15.0 + 12.0 * std::sin(k * 6.2831853 / sides), 1, 1);
    };
    Add(At(20.123, 15.321, 1, 1), corner(i), corner((i + 1) % sides));
  }
  const std::vector<float> picture = Picture();
  for (int y = 8; y < 22; ++y) {
    for (int x = 13; x < 27; ++x) EXPECT_FLOAT_EQ(picture[y * kWidth + x], 1.0f) << x << " " << y;
  }
}

TEST_F(MeshRasterizerTest, InsideOfSmoothSurfaceIsSampledAtItsCentres) {
  // The picture of a smooth surface is the same with and without edges between its triangles.
  const auto draw = [&](bool has_edge) {
    Clear();
    const ScreenVertex a = At(2, 2, 1, 0.2f), b = At(36, 2, 2, 0.8f), c = At(2, 27, 2, 0.4f), d = At(36, 27, 1, 0.9f);
    AddSmooth(a, b, c);
    AddSmooth(b, d, c);
    edges_ = {{0, 1}, {3, 4}, {4, 5}, {2, 0}};
    if (has_edge) edges_.push_back({1, 2});
    return Picture();
  };
  const std::vector<float> sampled = draw(true);
  const std::vector<float> smooth = draw(false);
  for (size_t i = 0; i < sampled.size(); ++i) EXPECT_NEAR(sampled[i], smooth[i], 0.002) << i;
  EXPECT_NE(sampled, smooth);
}

TEST_F(MeshRasterizerTest, IntersectionOfSurfacesWithoutCommonEdgeIsSampled) {
  // Two planes that intersect at the column x = 20.25, and no edge there.
  AddSmooth(At(-80.0, -100, 1.0f, 0.2f), At(120.5, -100, 3.0f, 0.2f), At(20.25, 200, 1.5f, 0.2f));
  AddSmooth(At(-80.0, -100, 3.0f, 0.8f), At(120.5, -100, 1.0f, 0.8f), At(20.25, 200, 1.5f, 0.8f));
  const std::vector<float> picture = Picture();
  for (int y = 2; y < 28; ++y) {
    EXPECT_FLOAT_EQ(picture[y * kWidth + 18], 0.2f);
    EXPECT_NEAR(picture[y * kWidth + 20], 0.2 * 0.75 + 0.8 * 0.25, 0.04);
    EXPECT_FLOAT_EQ(picture[y * kWidth + 22], 0.8f);
  }
}

TEST_F(MeshRasterizerTest, StripThatContainsNoCentreIsDrawn) {
  Add(At(5, 10.2, 1, 1), At(35, 10.2, 1, 1), At(35, 10.4, 1, 1));
  Add(At(5, 10.2, 1, 1), At(35, 10.4, 1, 1), At(5, 10.4, 1, 1));
  EXPECT_NEAR(Sum(Picture()), 6.0, 0.8);
}

TEST_F(MeshRasterizerTest, TrianglesWithoutAreaAreNotDrawn) {
  Add(At(5, 5, 1, 1), At(15, 10, 1, 1), At(25, 15, 1, 1));
  EXPECT_EQ(Sum(Picture()), 0.0);
}

}  // namespace
}  // namespace evpose
