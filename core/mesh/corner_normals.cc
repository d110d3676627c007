// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/corner_normals.h"

#include <Eigen/Geometry>
#include <cstdint>

#include "core/mesh/shape_fit.h"
#include "core/numerics/disjoint_sets.h"

namespace evpose {
namespace {

// Corners that share a vertex and are connected across smooth sides. Corner c of triangle t has
// the number 3 t + c.
class CornerFans {
 public:
  CornerFans(const FacetGraph& graph, const std::vector<bool>& is_smooth) : fans_(is_smooth.size()) {
    for (uint32_t side = 0; side < is_smooth.size(); ++side) {
      if (!is_smooth[side]) continue;
      // The opposite side has the other direction: it begins where this one ends.
      const uint32_t opposite = graph.opposite(side);
      fans_.Join(side, After(opposite));
    }
  }

  uint32_t Root(uint32_t corner) { return fans_.Find(corner); }

 private:
  static uint32_t After(uint32_t corner) { return corner / 3 * 3 + (corner + 1) % 3; }

  DisjointSets fans_;
};

double CornerAngle(const FacetGraph& graph, uint32_t corner) {
  const uint32_t triangle = corner / 3;
  const auto& corners = graph.mesh().triangles[triangle];
  const auto& points = graph.mesh().points;
  const Eigen::Vector3d& here = points[corners[corner % 3]];
  return AngleBetween(points[corners[(corner + 1) % 3]] - here, points[corners[(corner + 2) % 3]] - here);
}

}  // namespace

std::vector<std::array<Eigen::Vector3f, 3>> CornerNormals(const FacetGraph& graph, const std::vector<bool>& is_smooth) {
  CornerFans fans(graph, is_smooth);
  const auto num_corners = static_cast<uint32_t>(is_smooth.size());
  std::vector<Eigen::Vector3d> sums(num_corners, Eigen::Vector3d::Zero());
  std::vector<double> weights(num_corners);
  for (uint32_t triangle = 0; triangle < num_corners / 3; ++triangle) {
    const double area_m2 = FacetOf(graph.mesh(), triangle).area_m2;
    for (uint32_t corner = 3 * triangle; corner < 3 * triangle + 3; ++corner) {
      const double weight = CornerAngle(graph, corner) * area_m2;
      const uint32_t root = fans.Root(corner);
      sums[root] += weight * graph.normal(triangle);
      weights[root] += weight;
    }
  }
  std::vector<std::array<Eigen::Vector3f, 3>> normals(num_corners / 3);
  for (uint32_t corner = 0; corner < num_corners; ++corner) {
    const Eigen::Vector3d& sum = sums[fans.Root(corner)];
    // Opposite facets may cancel each other at the tip of a sliver.
    const bool has_direction = sum.norm() > 1e-6 * weights[fans.Root(corner)];
    normals[corner / 3][corner % 3] = (has_direction ? sum.normalized() : graph.normal(corner / 3)).cast<float>();
  }
  return normals;
}

}  // namespace evpose
