// SPDX-License-Identifier: Apache-2.0

// Least-squares circles (core/models/README.md, section 5).
#pragma once

#include <Eigen/Core>
#include <optional>

#include "absl/types/span.h"
#include "core/mesh/types/raw_mesh.h"

namespace evpose {

using Circle = EdgeCircle;

// The circle on which all points lie, within `max_distance_m` and 2 % of the height of their arc above the chord
// between its ends. The last point of a ring is the first one again. None: no value, also for fewer than five distinct
// points, because any three points lie on a circle and four of a short arc nearly so.
std::optional<Circle> FitCircle(absl::Span<const Eigen::Vector3d> points, double max_distance_m);

}  // namespace evpose
