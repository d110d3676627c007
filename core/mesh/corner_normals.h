// SPDX-License-Identifier: Apache-2.0

// Normals of a smooth surface at the corners of its triangles (core/mesh/README.md, section 10).
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "core/mesh/facet_graph.h"

namespace evpose {

// Returns for each corner the mean of the normals of the triangles at its vertex that are connected across smooth
// sides, as a unit vector. The weights are the products of their angles there and their areas. `is_smooth[side]` is
// equal for both sides of an edge, and false for a side without an opposite.
std::vector<std::array<Eigen::Vector3f, 3>> CornerNormals(const FacetGraph& graph, const std::vector<bool>& is_smooth);

}  // namespace evpose
