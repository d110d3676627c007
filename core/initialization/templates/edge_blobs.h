// SPDX-License-Identifier: Apache-2.0

// Places in the image where an object may be: boxes about connected edges.
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/events/event.h"
#include "core/initialization/templates/edge_distance_map.h"
#include "core/initialization/templates/event_edges.h"

namespace evpose {

// Returns boxes about groups of edge points, at most `max_boxes`: the largest groups first, then all of them together.
// Two points belong to one group if they are connected by points with gaps below a few percent of the image. A box
// leaves out the outermost points of its group, which may be noise.
std::vector<ImageBox> FindEdgeBlobs(absl::Span<const EventEdgePoint> points, SensorGeometry sensor, int max_boxes);

}  // namespace evpose
