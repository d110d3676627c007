// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/triangle_bvh.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

namespace evpose {
namespace {

struct Soup {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<std::array<uint32_t, 3>> triangles;
};

// Triangles of sizes from 1e-4 to 1 about `centre`, a tenth of them flat along an axis.
Soup RandomSoup(const Eigen::Vector3d& centre, int num_triangles, std::mt19937& random) {
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  const auto vector = [&] { return Eigen::Vector3d(uniform(random), uniform(random), uniform(random)); };
  Soup soup;
  for (int i = 0; i < num_triangles; ++i) {
    const Eigen::Vector3d corner = vector();
    const double size = std::pow(10.0, 2.0 * uniform(random) - 2.0);
    for (int k = 0; k < 3; ++k) {
      Eigen::Vector3d offset = size * vector();
      if (i % 10 < 3) offset[i % 10] = 0.0;
      soup.vertices.push_back(centre + corner + offset);
    }
    const auto first = static_cast<uint32_t>(3 * i);
    soup.triangles.push_back({first, first + 1, first + 2});
  }
  return soup;
}

// Each triangle is a tree of its own, whose single box contains nothing else.
std::vector<TriangleBvh> OneByOne(const Soup& soup) {
  std::vector<TriangleBvh> trees;
  for (const std::array<uint32_t, 3>& triangle : soup.triangles) {
    trees.emplace_back(soup.vertices, absl::MakeConstSpan(&triangle, 1));
  }
  return trees;
}

TEST(TriangleBvhTest, OcclusionIsThatOfTheTrianglesOneByOne) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(-1.5, 1.5);
  for (const Eigen::Vector3d& centre : {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(3e4, -2e4, 10.0)}) {
    const Soup soup = RandomSoup(centre, 200, random);
    const TriangleBvh tree(soup.vertices, soup.triangles);
    const std::vector<TriangleBvh> single = OneByOne(soup);
    int num_occluded = 0;
    uint32_t hint = ~0u;
    for (int trial = 0; trial < 4000; ++trial) {
      Eigen::Vector3d origin = centre + Eigen::Vector3d(uniform(random), uniform(random), uniform(random));
      Eigen::Vector3d point = centre + Eigen::Vector3d(uniform(random), uniform(random), uniform(random));
      // Rays along an axis, within a plane of axes, through a corner of a triangle, and from afar.
      if (trial % 8 == 1) point.head<2>() = origin.head<2>();
      if (trial % 8 == 2) point.z() = origin.z();
      if (trial % 8 == 3) point = soup.vertices[trial % soup.vertices.size()] * 2.0 - origin;
      if (trial % 8 == 4) origin = centre + 1e5 * (origin - centre);
      if (trial % 8 == 5) point = origin = soup.vertices[trial % soup.vertices.size()];
      bool expected = false;
      for (const TriangleBvh& one : single) expected |= one.IsOccluded(origin, point, 1e-3);
      const bool is_occluded = tree.IsOccluded(origin, point, 1e-3);
      // The hint does not change the result: it is a random leaf, or the one that was found last.
      if (trial % 3 == 0) hint = static_cast<uint32_t>(random() % 300);
      EXPECT_EQ(tree.IsOccluded(origin, point, 1e-3, hint), is_occluded) << trial;
      // Whether a ray through a corner meets the triangle is a matter of rounding, which a box may decide. The box of a
      // leaf contains those of its triangles.
      if (expected || trial % 8 != 3) {
        EXPECT_EQ(is_occluded, expected) << trial;
      }
      num_occluded += expected;
    }
    EXPECT_GT(num_occluded, 400);
    EXPECT_LT(num_occluded, 3600);
  }
}

TEST(TriangleBvhTest, TheFirstNormalIsThatOfTheNearestTriangle) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> uniform(-1.5, 1.5);
  const Soup soup = RandomSoup({0, 0, 0}, 200, random);
  const TriangleBvh tree(soup.vertices, soup.triangles);
  const std::vector<TriangleBvh> single = OneByOne(soup);
  int num_hit = 0;
  for (int trial = 0; trial < 4000; ++trial) {
    const Eigen::Vector3d origin(uniform(random), uniform(random), uniform(random));
    Eigen::Vector3d end(uniform(random), uniform(random), uniform(random));
    if (trial % 8 == 1) end.head<2>() = origin.head<2>();  // along an axis
    std::optional<Eigen::Vector3d> expected;
    double nearest = 1.0;
    for (size_t i = 0; i < single.size(); ++i) {
      const std::optional<Eigen::Vector3d> normal = single[i].FirstNormal(origin, end);
      if (!normal) continue;
      EXPECT_LE(normal->dot(end - origin), 0.0);
      const double at = normal->dot(soup.vertices[soup.triangles[i][0]] - origin) / normal->dot(end - origin);
      if (at > nearest) continue;
      nearest = at;
      expected = normal;
    }
    const std::optional<Eigen::Vector3d> found = tree.FirstNormal(origin, end);
    EXPECT_EQ(found, expected) << trial;
    num_hit += found.has_value();
  }
  EXPECT_GT(num_hit, 400);
  EXPECT_LT(num_hit, 3600);
}

TEST(TriangleBvhTest, NearTrianglesAreThoseOneByOne) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> uniform(-1.2, 1.2);
  const Soup soup = RandomSoup({0, 0, 0}, 200, random);
  const TriangleBvh tree(soup.vertices, soup.triangles);
  const std::vector<TriangleBvh> single = OneByOne(soup);
  std::vector<TriangleBvh::Near> found, near;
  size_t num_near = 0;
  int num_found = 0;
  uint32_t hint = ~0u;
  for (int trial = 0; trial < 1000; ++trial) {
    const Eigen::Vector3d point(uniform(random), uniform(random), uniform(random));
    const double radius_m = 0.05 * (1 + trial % 8);
    size_t expected = 0;
    for (const TriangleBvh& one : single) {
      one.FindNear(point, radius_m, near);
      expected += near.size();
    }
    tree.FindNear(point, radius_m, found);
    EXPECT_EQ(found.size(), expected);
    num_near += expected;
    // The hint does not change the result: it is a random triangle, or the one that was found last.
    const Eigen::Vector3d direction = Eigen::Vector3d(uniform(random), uniform(random), uniform(random)).normalized();
    const bool has_near = std::any_of(found.begin(), found.end(), [&](const TriangleBvh::Near& triangle) {
      return triangle.normal.dot(direction) >= 0.5;
    });
    if (trial % 3 == 0) hint = static_cast<uint32_t>(random() % 300);
    EXPECT_EQ(tree.HasNear(point, radius_m, direction, 0.5, hint), has_near);
    EXPECT_EQ(tree.HasNear(point, radius_m, direction, 0.5), has_near);
    num_found += has_near;
  }
  EXPECT_GT(num_near, 1000u);
  EXPECT_GT(num_found, 100);
  EXPECT_LT(num_found, 900);
}

}  // namespace
}  // namespace evpose
