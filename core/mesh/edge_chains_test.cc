// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/edge_chains.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

namespace evpose {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

bool Always(uint32_t, uint32_t) { return true; }

// Points in the plane z = 0, joined in their order; closed if `is_ring`.
struct Path {
  std::vector<Eigen::Vector3d> points;
  std::vector<EdgeEnds> edges;
};

Path PathThrough(const std::vector<Eigen::Vector3d>& points, bool is_ring) {
  Path path{points, {}};
  const auto count = static_cast<uint32_t>(points.size());
  for (uint32_t i = 0; i + (is_ring ? 0 : 1) < count; ++i) path.edges.push_back({i, (i + 1) % count});
  return path;
}

Path Polygon(int corners, double radius) {
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < corners; ++i) {
    const double angle = 2 * std::numbers::pi * i / corners;
    points.push_back({radius * std::cos(angle), radius * std::sin(angle), 0.0});
  }
  return PathThrough(points, true);
}

CurvedParts CurvesOf(const Path& path, double diameter) {
  return FindCurvedParts(path.points, path.edges, diameter, Always);
}

TEST(EdgeChainsTest, ChainsEndWhereMoreThanTwoEdgesMeet) {
  // A path of three edges whose second inner vertex has a branch, and a ring.
  const std::vector<EdgeEnds> edges = {{0, 1}, {1, 2}, {2, 3}, {2, 4}, {5, 6}, {6, 7}, {5, 7}};
  const std::vector<EdgeChain> chains = FindChains(edges, 8, Always);
  ASSERT_THAT(chains, SizeIs(4));
  EXPECT_THAT(chains[0].vertices, ElementsAre(0, 1, 2));
  EXPECT_THAT(chains[0].edges, ElementsAre(0, 1));
  EXPECT_THAT(chains[1].edges, ElementsAre(2));
  EXPECT_THAT(chains[2].edges, ElementsAre(3));
  EXPECT_TRUE(chains[3].is_closed());
  EXPECT_THAT(chains[3].edges, testing::UnorderedElementsAre(4, 5, 6));
}

TEST(EdgeChainsTest, ChainsEndWhereEdgesMayNotBeJoined) {
  const std::vector<EdgeEnds> edges = {{0, 1}, {1, 2}, {2, 3}};
  const auto not_at_1 = [](uint32_t a, uint32_t b) { return a + b != 1; };
  const std::vector<EdgeChain> chains = FindChains(edges, 4, not_at_1);
  ASSERT_THAT(chains, SizeIs(2));
  EXPECT_THAT(chains[0].vertices, ElementsAre(0, 1));
  EXPECT_THAT(chains[1].vertices, ElementsAre(1, 2, 3));
}

TEST(EdgeChainsTest, PolygonsOfFewSidesAreStraightAndOfManyAreRings) {
  for (const int corners : {3, 4, 6, 8, 10}) {
    EXPECT_THAT(CurvesOf(Polygon(corners, 1.0), 2.0).chains, IsEmpty()) << corners;
  }
  for (const int corners : {12, 16, 32, 256, 5000}) {
    const Path path = Polygon(corners, 1.0);
    const CurvedParts curved = CurvesOf(path, 2.0);
    ASSERT_THAT(curved.chains, SizeIs(1)) << corners;
    EXPECT_TRUE(curved.chains[0].is_closed());
    EXPECT_EQ(curved.chains[0].vertices.size(), curved.chains[0].edges.size() + 1);
    for (const bool is_curved : curved.is_curved) EXPECT_TRUE(is_curved);
    double length = 0.0;
    const std::vector<uint32_t>& vertices = curved.chains[0].vertices;
    for (size_t i = 1; i < vertices.size(); ++i) {
      length += (path.points[vertices[i]] - path.points[vertices[i - 1]]).norm();
    }
    EXPECT_NEAR(length, 2.0 * corners * std::sin(std::numbers::pi / corners), 1e-3) << corners;
  }
}

TEST(EdgeChainsTest, RoundedCornersAreCurvesAndTheSidesBetweenThemLines) {
  // A square of side 2 with quarter circles of radius 0.1 in four chords.
  std::vector<Eigen::Vector3d> points;
  for (int corner = 0; corner < 4; ++corner) {
    const double start = corner * std::numbers::pi / 2;
    const double x = corner == 0 || corner == 3 ? 0.9 : -0.9, y = corner < 2 ? 0.9 : -0.9;
    for (int i = 0; i <= 4; ++i) {
      const double angle = start + i * std::numbers::pi / 8;
      points.push_back({x + 0.1 * std::cos(angle), y + 0.1 * std::sin(angle), 0.0});
    }
  }
  const Path path = PathThrough(points, true);
  const CurvedParts curved = CurvesOf(path, 2.7);
  ASSERT_THAT(curved.chains, SizeIs(4));
  for (const EdgeChain& chain : curved.chains) EXPECT_THAT(chain.edges, SizeIs(4));
  EXPECT_EQ(std::count(curved.is_curved.begin(), curved.is_curved.end(), false), 4);
}

TEST(EdgeChainsTest, CornersCutCurves) {
  // Two half circles that meet at right angles to their chord.
  std::vector<Eigen::Vector3d> points;
  for (const double centre : {0.0, 2.0}) {
    for (int i = 0; i < 16; ++i) {
      const double angle = i * std::numbers::pi / 16;
      points.push_back({centre - std::cos(angle), std::sin(angle), 0.0});
    }
  }
  const CurvedParts curved = CurvesOf(PathThrough(points, false), 4.0);
  EXPECT_THAT(curved.chains, SizeIs(2));
}

TEST(EdgeChainsTest, JaggedChainOfShortEdgesIsOneCurve) {
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 40; ++i) points.push_back({0.01 * i, i % 2 == 0 ? 0.0 : 0.005, 0.0});
  EXPECT_THAT(CurvesOf(PathThrough(points, false), 1.0).chains, SizeIs(1));
  EXPECT_THAT(CurvesOf(PathThrough(points, false), 0.1).chains, IsEmpty()) << "a zigzag as long as the object";
}

TEST(EdgeChainsTest, CollinearEdgesAreNotACurve) {
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 100; ++i) points.push_back({0.01 * i, 1e-6 * (i % 3), 0.0});
  EXPECT_THAT(CurvesOf(PathThrough(points, false), 1.0).chains, IsEmpty());
}

}  // namespace
}  // namespace evpose
