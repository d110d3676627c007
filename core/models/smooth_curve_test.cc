// SPDX-License-Identifier: Apache-2.0
#include "core/models/smooth_curve.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/models/circle_fit.h"

namespace evpose {
namespace {

using ::testing::SizeIs;

constexpr size_t kManyPoints = 100'000;

// A circle of radius 0.3 in an oblique plane, at an angle in turns.
const Eigen::Vector3d kObliqueCentre(0.4, -0.2, 0.7);
const Eigen::Vector3d kObliqueAxis = Eigen::Vector3d(1.0, 2.0, -2.0) / 3.0;
constexpr double kObliqueRadius = 0.3;

Eigen::Vector3d OnOblique(double turn) {
  const Eigen::Vector3d e1 = Eigen::Vector3d(2.0, 1.0, 2.0) / 3.0, e2 = Eigen::Vector3d(2.0, -2.0, -1.0) / 3.0;
  return kObliqueCentre + kObliqueRadius * (std::cos(2.0 * M_PI * turn) * e1 + std::sin(2.0 * M_PI * turn) * e2);
}

// Vertices as in a binary STL.
std::vector<Eigen::Vector3d> ObliqueVertices(int count, double turns) {
  std::vector<Eigen::Vector3d> vertices;
  for (int i = 0; i <= count; ++i) {
    const Eigen::Vector3d p = OnOblique(turns == 1.0 ? static_cast<double>(i % count) / count : turns * i / count);
    vertices.emplace_back(p.cast<float>().cast<double>());
  }
  return vertices;
}

// Largest distance of the segments from the circle.
double FromOblique(const std::vector<Eigen::Vector3d>& points) {
  double largest = 0.0;
  for (size_t i = 0; i + 1 < points.size(); ++i) {
    for (const double t : {0.0, 0.5}) {
      const Eigen::Vector3d v = points[i] + t * (points[i + 1] - points[i]) - kObliqueCentre;
      const double height = v.dot(kObliqueAxis);
      largest = std::max(largest, std::hypot(height, (v - height * kObliqueAxis).norm() - kObliqueRadius));
    }
  }
  return largest;
}

TEST(SmoothCurveTest, RingsAndArcsOfAnyTessellationAreTheirCircle) {
  for (const int count : {12, 16, 24, 37, 60, 120}) {
    for (const double turns : {1.0, 0.02 * count}) {
      if (turns > 1.0) continue;
      const std::vector<Eigen::Vector3d> vertices = ObliqueVertices(count, turns);
      size_t max_inserted = kManyPoints;
      const SmoothCurve curve = SmoothChain(vertices, 1.0, max_inserted);
      EXPECT_LT(FromOblique(curve.points), 2.1e-5) << count << " " << turns;
      EXPECT_EQ(curve.points.front(), vertices.front());
      EXPECT_EQ(curve.points.back(), vertices.back());
      ASSERT_THAT(curve.chord_of, SizeIs(curve.points.size() - 1));
      EXPECT_EQ(max_inserted, kManyPoints - (curve.points.size() - vertices.size()));
      for (size_t i = 0; i < curve.chord_of.size(); ++i) {
        const Eigen::Vector3d middle = 0.5 * (curve.points[i] + curve.points[i + 1]);
        const Eigen::Vector3d &p = vertices[curve.chord_of[i]], &q = vertices[curve.chord_of[i] + 1];
        EXPECT_LT((middle - 0.5 * (p + q)).norm(), 0.51 * (p - q).norm());
      }
    }
  }
}

TEST(SmoothCurveTest, FinePolylinesStay) {
  size_t max_inserted = kManyPoints;
  EXPECT_THAT(SmoothChain(ObliqueVertices(400, 1.0), 1.0, max_inserted).points, SizeIs(401));
}

TEST(SmoothCurveTest, CurveBeyondTheBudgetKeepsItsChords) {
  size_t max_inserted = 100;
  EXPECT_THAT(SmoothChain(ObliqueVertices(16, 1.0), 1.0, max_inserted).points, SizeIs(17));
  EXPECT_EQ(max_inserted, 100u);
}

TEST(SmoothCurveTest, StraightSideOfACircleStays) {
  // 18 of 24 chords, and one chord for the rest, which begins and ends on the circle.
  std::vector<Eigen::Vector3d> vertices;
  for (int i = 0; i <= 21; ++i) vertices.push_back(OnOblique(i / 24.0));
  vertices.push_back(OnOblique(0.0));
  size_t max_inserted = kManyPoints;
  const SmoothCurve curve = SmoothChain(vertices, 1.0, max_inserted);
  EXPECT_EQ(std::count(curve.chord_of.begin(), curve.chord_of.end(), 21u), 1);
  EXPECT_GT(std::count(curve.chord_of.begin(), curve.chord_of.end(), 0u), 3);
  EXPECT_GT(std::count(curve.chord_of.begin(), curve.chord_of.end(), 20u), 3);
}

TEST(SmoothCurveTest, PolygonsAndZigzagsStay) {
  std::vector<Eigen::Vector3d> zigzag;
  for (int i = 0; i < 20; ++i) zigzag.emplace_back(0.05 * i, 0.005 * (i % 2), 0.0);
  for (const auto& vertices : {ObliqueVertices(8, 1.0), ObliqueVertices(6, 1.0), zigzag}) {
    size_t max_inserted = kManyPoints;
    const SmoothCurve curve = SmoothChain(vertices, 1.0, max_inserted);
    // The ends of the zigzag have one neighbour only.
    EXPECT_LE(curve.points.size(), vertices.size() + (vertices == zigzag ? 60 : 0));
  }
}

// The rim of a hole of radius b through a cylinder of radius a: the curve (sqrt(a^2 - y^2), b cos, b sin).
Eigen::Vector3d OnRim(double turn) {
  const double y = 0.3 * std::cos(2.0 * M_PI * turn), z = 0.3 * std::sin(2.0 * M_PI * turn);
  return {std::sqrt(0.16 - y * y), y, z};
}

TEST(SmoothCurveTest, CurvesWithoutACircleAreInterpolated) {
  for (const int count : {24, 48}) {
    std::vector<Eigen::Vector3d> vertices;
    for (int i = 0; i <= count; ++i) vertices.push_back(OnRim(static_cast<double>(i % count) / count));
    EXPECT_FALSE(FitCircle(vertices, 5e-4).has_value());
    size_t max_inserted = kManyPoints;
    const SmoothCurve curve = SmoothChain(vertices, 1.0, max_inserted);
    const auto error = [](const std::vector<Eigen::Vector3d>& points) {
      double largest = 0.0;
      for (size_t i = 0; i + 1 < points.size(); ++i) {
        const Eigen::Vector3d p = 0.5 * (points[i] + points[i + 1]);
        largest =
            std::max({largest, std::abs(std::hypot(p.y(), p.z()) - 0.3), std::abs(std::hypot(p.x(), p.y()) - 0.4)});
      }
      return largest;
    };
    EXPECT_LT(error(curve.points), 0.2 * error(vertices)) << count;
  }
}

TEST(CircleFitTest, IsExactAndRejectsOtherCurves) {
  const std::optional<Circle> circle = FitCircle(ObliqueVertices(16, 1.0), 1e-4);
  ASSERT_TRUE(circle.has_value());
  EXPECT_NEAR(circle->radius_m, kObliqueRadius, 1e-6);
  EXPECT_LT((circle->centre - kObliqueCentre).norm(), 1e-6);
  EXPECT_NEAR(std::abs(circle->axis.dot(kObliqueAxis)), 1.0, 1e-9);
  std::vector<Eigen::Vector3d> line, few = ObliqueVertices(3, 0.3), bent = ObliqueVertices(16, 0.7);
  for (int i = 0; i < 9; ++i) line.emplace_back(0.1 * i, 0.2 * i, 0.0);
  bent[4] += 2e-4 * kObliqueAxis;
  EXPECT_FALSE(FitCircle(line, 1e-4).has_value());
  EXPECT_FALSE(FitCircle(few, 1e-4).has_value());
  EXPECT_FALSE(FitCircle(bent, 1e-4).has_value());
  EXPECT_FALSE(FitCircle(std::vector<Eigen::Vector3d>(9, kObliqueCentre), 1e-4).has_value());
}

}  // namespace
}  // namespace evpose
