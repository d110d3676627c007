// SPDX-License-Identifier: Apache-2.0

// The edges of a model that are known exactly, from its CAD model (core/models/README.md, section 1).
#pragma once

#include <optional>
#include <vector>

#include "core/mesh/edge_chains.h"
#include "core/mesh/surface_regions.h"

namespace evpose {

struct ExactCurves {
  struct Curve {
    // Points of the exact edge, and for each segment between them the edge of the surface (index into
    // SurfaceEdges::edges) to which it belongs.
    EdgeChain chain;
    std::optional<EdgeCircle> circle;
  };
  std::vector<Curve> curves;
  // For each edge of the surface, whether it is part of an exact straight line, or of one of `curves`.
  std::vector<bool> is_straight;
  std::vector<bool> is_curved;
};

// Parts of exact edges that are no edges of the surface, such as those of walls between bodies, are omitted.
ExactCurves FindExactCurves(const RawMesh& mesh, const SurfaceEdges& edges);

}  // namespace evpose
