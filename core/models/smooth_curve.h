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

// The curve on which the vertices of a chain lie: all of them, and points between them so that segments are within
// 2e-5 diameters of arcs. These are arcs of the circle on which they are known to lie or that fits all vertices, or
// else of circles through three successive vertices. A chord beside a corner or a longer chord, or between opposite
// turns, stays. At most `max_inserted` points are inserted, from which their number is subtracted: a curve that needs
// more keeps its chords.
SmoothCurve SmoothChain(absl::Span<const Eigen::Vector3d> vertices, double diameter_m, size_t& max_inserted,
                        const std::optional<EdgeCircle>& circle = std::nullopt);

}  // namespace evpose
