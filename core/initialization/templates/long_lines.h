// SPDX-License-Identifier: Apache-2.0

// Long straight edges of something before or beside an object (core/initialization/templates/README.md, section 2).
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/events/event.h"
#include "core/initialization/templates/event_edges.h"

namespace evpose {

// Returns the points without those near straight lines that are longer than everything else in their direction: the
// sides of a bar before an object, of a table or of an arm. They connect the edges of an object with edges far from it,
// so that no box contains the object alone. Returns an empty list if there is no such line. Deterministic.
std::vector<EventEdgePoint> WithoutLongLines(absl::Span<const EventEdgePoint> points, SensorGeometry sensor);

}  // namespace evpose
