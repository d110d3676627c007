// SPDX-License-Identifier: Apache-2.0

// Which edges of a mesh are edges of the surface that the mesh approximates (core/mesh/README.md, section 8).
#pragma once

#include <vector>

#include "core/mesh/facet_graph.h"
#include "core/mesh/surface_regions.h"

namespace evpose {

// The creases and boundaries in the order of their vertices (SortedEdgeUses). At most 32 triangles of an edge are
// listed.
std::vector<MeshEdge> FindCreases(const FacetGraph& graph, const CreaseOptions& options, double diameter_m);

}  // namespace evpose
