// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/region_parts.h"

#include <gtest/gtest.h>

#include <numeric>

#include "core/base/yields_testing.h"

namespace evpose {
namespace {

constexpr double kDiameterM = 1000.0;

// A square of 2 m with `side`^2 squares, and at each edge of its border a triangle that reaches 40 m outwards and rises
// or falls by 6 to 96 mm. The square lies in the plane of each of these triangles within the tolerance, 5 mm, but
// hardly any other one of them does: from each of them a part can grow over the whole square. None is wide enough to be
// taken.
RawMesh SquareWithSpikes(uint32_t side) {
  RawMesh mesh;
  const auto corner = [side](uint32_t x, uint32_t y) { return y * (side + 1) + x; };
  for (uint32_t y = 0; y <= side; ++y) {
    for (uint32_t x = 0; x <= side; ++x) mesh.points.emplace_back(2.0 * x / side - 1.0, 2.0 * y / side - 1.0, 0.0);
  }
  int num_spikes = 0;
  const auto add_spike = [&](uint32_t from, uint32_t to, const Eigen::Vector3d& outwards) {
    const Eigen::Vector3d middle = 0.5 * (mesh.points[from] + mesh.points[to]);
    const int number = num_spikes++ / 4;
    const double rise = (number % 2 == 0 ? 0.006 : -0.006) * (1 + number / 2 % 16);
    mesh.points.push_back(middle + 40.0 * outwards + rise * Eigen::Vector3d::UnitZ());
    mesh.triangles.push_back({to, from, static_cast<uint32_t>(mesh.points.size() - 1)});
  };
  for (uint32_t y = 0; y < side; ++y) {
    for (uint32_t x = 0; x < side; ++x) {
      mesh.triangles.push_back({corner(x, y), corner(x + 1, y), corner(x + 1, y + 1)});
      mesh.triangles.push_back({corner(x, y), corner(x + 1, y + 1), corner(x, y + 1)});
    }
    add_spike(corner(y, 0), corner(y + 1, 0), -Eigen::Vector3d::UnitY());
    add_spike(corner(side, y), corner(side, y + 1), Eigen::Vector3d::UnitX());
    add_spike(corner(y + 1, side), corner(y, side), Eigen::Vector3d::UnitY());
    add_spike(corner(0, y + 1), corner(0, y), -Eigen::Vector3d::UnitX());
  }
  return mesh;
}

TEST(RegionPartsTest, TheStepsAreProportionalToTheTriangles) {
  const RawMesh mesh = SquareWithSpikes(32);
  std::vector<uint32_t> all(mesh.triangles.size());
  std::iota(all.begin(), all.end(), 0u);
  std::vector<RegionPart> parts;
  const size_t yields = CountYields([&] { parts = FindRegionParts(mesh, all, kDiameterM); });
  // Without the bound, each of the 128 spikes visits the 2048 triangles of the square six times.
  const double visits_per_triangle = 64.0 * static_cast<double>(yields) / static_cast<double>(all.size());
  EXPECT_GT(visits_per_triangle, 32.0) << "the bound is reached";
  EXPECT_LT(visits_per_triangle, 100.0);
  size_t num_triangles = 0;
  for (const RegionPart& part : parts) num_triangles += part.triangles.size();
  EXPECT_EQ(num_triangles, all.size());
}

}  // namespace
}  // namespace evpose
