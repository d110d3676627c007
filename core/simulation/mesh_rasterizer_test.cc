// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/mesh_rasterizer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numeric>
#include <vector>

namespace evpose {
namespace {

class MeshRasterizerTest : public testing::Test {
 protected:
  static constexpr int kWidth = 40;
  static constexpr PixelRect kImage = {0, 0, kWidth, 30};

  MeshRasterizerTest() { rasterizer_.Begin(kImage); }

  static ScreenVertex At(double x, double y, float depth_m, float light) { return {{x, y}, 1.0f / depth_m, light}; }
  void Add(const ScreenVertex& a, const ScreenVertex& b, const ScreenVertex& c) {
    rasterizer_.AddTriangle({&a, &b, &c});
  }
  std::vector<float> Picture() const {
    std::vector<float> picture(static_cast<size_t>(kWidth) * kImage.y1, 0.0f);
    rasterizer_.CompositeOnto(kWidth, picture);
    return picture;
  }
  static double Sum(const std::vector<float>& picture) { return std::accumulate(picture.begin(), picture.end(), 0.0); }

  MeshRasterizer rasterizer_;
};

TEST_F(MeshRasterizerTest, CoversTheAreaOfTheTriangle) {
  Add(At(3.2, 4.7, 1, 1), At(31.4, 8.1, 1, 1), At(12.9, 27.3, 1, 1));
  const double area = 0.5 * ((31.4 - 3.2) * (27.3 - 4.7) - (8.1 - 4.7) * (12.9 - 3.2));
  EXPECT_NEAR(Sum(Picture()), area, 0.005 * area);
}

TEST_F(MeshRasterizerTest, EdgeAlongColumnMovesInSixteenSteps) {
  std::vector<double> sums;
  for (int i = 0; i <= 16; ++i) {
    rasterizer_.Begin(kImage);
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
  rasterizer_.Begin(kImage);
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

TEST_F(MeshRasterizerTest, TrianglesWithoutAreaAreNotDrawn) {
  Add(At(5, 5, 1, 1), At(15, 10, 1, 1), At(25, 15, 1, 1));
  EXPECT_EQ(Sum(Picture()), 0.0);
}

}  // namespace
}  // namespace evpose
