// SPDX-License-Identifier: Apache-2.0

// Points between the vertices of a tessellated curve (core/models/README.md, section 5).
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "absl/types/span.h"
#include "core/mesh/types/raw_mesh.h"

namespace evpose {

struct SmoothCurve {
  std::vector<Eigen::Vector3d> points;
  std::vector<uint32_t> chord_of;  // for each segment between successive points, that between the vertices
};

// The curve on which the vertices of a chain lie: all vertices, and points between them so that each segment is within
// 2e-5 diameters of its arc. The arcs are those of the given `circle`, of the circle that fits all vertices, or else of
// circles through three successive vertices. Without a given circle, a chord stays if neither neighbour continues it
// smoothly, because of a corner or a difference in length, or if its neighbours turn to opposite sides. Inserts at most
// `max_inserted` points and subtracts their number from it; a curve that needs more keeps its chords.
SmoothCurve SmoothChain(absl::Span<const Eigen::Vector3d> vertices, double diameter_m, size_t& max_inserted,
                        const std::optional<EdgeCircle>& circle = std::nullopt);

}  // namespace evpose
