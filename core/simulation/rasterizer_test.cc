// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/rasterizer.h"

#include <gtest/gtest.h>

#include <numeric>
#include <vector>

#include "core/numerics/random.h"

namespace evpose {
namespace {

using Eigen::Vector2d;

constexpr int kWidth = 24;
constexpr int kHeight = 20;
constexpr size_t kNumPixels = size_t{kWidth} * kHeight;
constexpr PixelRect kImage = {0, 0, kWidth, kHeight};

std::vector<float> Rasterize(const std::vector<Vector2d>& polygon, double value = 1.0, double alpha = 1.0,
                             float background = 0.0f) {
  CoverageRasterizer rasterizer(kWidth, kHeight);
  std::vector<float> picture(kNumPixels, background);
  rasterizer.Begin(BoundingRect(polygon).Intersection(kImage));
  rasterizer.AddPolygon(polygon, value, alpha);
  rasterizer.CompositeOnto(picture);
  return picture;
}

// Twice the signed area of the triangle of the edge a-b and a point; its sign is the side of the point.
double Side(const Vector2d& a, const Vector2d& b, const Vector2d& p) {
  return (b.x() - a.x()) * (p.y() - a.y()) - (b.y() - a.y()) * (p.x() - a.x());
}

double SampledCoverage(const std::vector<Vector2d>& triangle, int x, int y) {
  constexpr int kSamples = 40;
  int inside = 0;
  for (int i = 0; i < kSamples * kSamples; ++i) {
    const int row = i / kSamples;
    const Vector2d p(x - 0.5 + (i % kSamples + 0.5) / kSamples, y - 0.5 + (row + 0.5) / kSamples);
    bool all = true;
    for (int k = 0; k < 3; ++k) all = all && Side(triangle[k], triangle[(k + 1) % 3], p) <= 0.0;
    inside += all ? 1 : 0;
  }
  return inside / (1.0 * kSamples * kSamples);
}

TEST(CoverageRasterizerTest, TrianglesEqualSuperSampling) {
  Random random(3);
  for (int trial = 0; trial < 60; ++trial) {
    std::vector<Vector2d> triangle;
    // The triangles extend beyond every border.
    for (int k = 0; k < 3; ++k)
      triangle.push_back({random.Uniform(-15, kWidth + 15), random.Uniform(-15, kHeight + 15)});
    if (Side(triangle[0], triangle[1], triangle[2]) > 0.0) std::swap(triangle[1], triangle[2]);
    const std::vector<float> picture = Rasterize(triangle);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        ASSERT_NEAR(picture[y * kWidth + x], SampledCoverage(triangle, x, y), 0.03) << trial << " " << x << " " << y;
      }
    }
  }
}

TEST(CoverageRasterizerTest, CoverageIsTheExactArea) {
  Random random(5);
  for (int trial = 0; trial < 200; ++trial) {
    const Vector2d a{random.Uniform(0, kWidth - 1), random.Uniform(0, kHeight - 1)};
    const Vector2d b{random.Uniform(0, kWidth - 1), random.Uniform(0, kHeight - 1)};
    const Vector2d c{random.Uniform(0, kWidth - 1), random.Uniform(0, kHeight - 1)};
    const std::vector<float> picture = Rasterize({a, b, c});
    const double sum = std::accumulate(picture.begin(), picture.end(), 0.0);
    EXPECT_NEAR(sum, -0.5 * Side(a, b, c), 1e-4);  // counter-clockwise on the screen is positive
  }
}

TEST(CoverageRasterizerTest, AnEdgeThatMovesByAnyFractionChangesThePictureByIt) {
  for (double x = 3.0; x < 5.0; x += 0.01) {
    const std::vector<float> picture = Rasterize({{x, 2.0}, {x, 8.0}, {12.0, 8.0}, {12.0, 2.0}});
    const double row_sum =
        std::accumulate(picture.begin() + ptrdiff_t{5} * kWidth, picture.begin() + ptrdiff_t{6} * kWidth, 0.0);
    EXPECT_NEAR(row_sum, 12.0 - x, 1e-5);
  }
}

TEST(CoverageRasterizerTest, AdjacentPolygonsLeaveNoGap) {
  CoverageRasterizer rasterizer(kWidth, kHeight);
  std::vector<float> picture(kNumPixels, 9.0f);
  rasterizer.Begin(kImage);
  const Vector2d a(1.3, 1.7), b(2.9, 17.1), c(20.2, 18.4), d(18.8, 2.2);
  rasterizer.AddPolygon(std::vector<Vector2d>{a, b, c}, 0.5, 1.0);
  rasterizer.AddPolygon(std::vector<Vector2d>{a, c, d}, 0.5, 1.0);
  rasterizer.CompositeOnto(picture);
  for (int y = 4; y < 15; ++y) {
    for (int x = 5; x < 15; ++x) EXPECT_NEAR(picture[y * kWidth + x], 0.5, 1e-5);
  }
}

TEST(CoverageRasterizerTest, CompositesOntoThePicture) {
  const std::vector<float> picture = Rasterize({{4.0, 4.0}, {4.0, 9.0}, {10.0, 9.0}, {10.0, 4.0}}, 0.8, 1.0, 0.2f);
  EXPECT_NEAR(picture[6 * kWidth + 7], 0.8, 1e-6);
  EXPECT_NEAR(picture[6 * kWidth + 4], 0.5, 1e-6);  // half covered
  EXPECT_NEAR(picture[6 * kWidth + 3], 0.2, 1e-6);
  EXPECT_NEAR(picture[4 * kWidth + 4], 0.35, 1e-6);  // a corner: a quarter
}

TEST(CoverageRasterizerTest, NothingOutsideTheImage) {
  const std::vector<float> picture = Rasterize({{40.0, 4.0}, {40.0, 9.0}, {50.0, 9.0}, {50.0, 4.0}});
  for (const float value : picture) EXPECT_EQ(value, 0.0f);
}

TEST(GaussianBlurTest, KeepsTheSumAndSpreadsBySigma) {
  constexpr double kSigma = 0.7;
  std::vector<float> source(kNumPixels, 0.0f);
  std::vector<float> target(source.size());
  source[10 * kWidth + 12] = 1.0f;
  GaussianBlur blur(kSigma);
  blur.Apply(source, kWidth, kHeight, kImage, target);
  double sum = 0.0, mean = 0.0, variance = 0.0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      sum += target[y * kWidth + x];
      mean += target[y * kWidth + x] * (x - 12);
      variance += target[y * kWidth + x] * (x - 12) * (x - 12);
    }
  }
  EXPECT_NEAR(sum, 1.0, 1e-5);
  EXPECT_NEAR(mean, 0.0, 1e-6);
  EXPECT_NEAR(variance, kSigma * kSigma, 0.02);
}

TEST(GaussianBlurTest, KeepsAnEvenPictureUpToTheBorders) {
  const std::vector<float> source(kNumPixels, 0.37f);
  std::vector<float> target(source.size());
  GaussianBlur(0.6).Apply(source, kWidth, kHeight, kImage, target);
  for (const float value : target) EXPECT_NEAR(value, 0.37f, 1e-6);
}

TEST(GaussianBlurTest, ASigmaOfZeroCopies) {
  std::vector<float> source(kNumPixels);
  for (size_t i = 0; i < source.size(); ++i) source[i] = static_cast<float>(i);
  std::vector<float> target(source.size());
  GaussianBlur(0.0).Apply(source, kWidth, kHeight, kImage, target);
  EXPECT_EQ(source, target);
}

}  // namespace
}  // namespace evpose
