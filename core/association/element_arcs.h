// SPDX-License-Identifier: Apache-2.0

// Joins successive elements of a curve to arcs, so that the cost of a window depends on the number of arcs
// (core/association/README.md, section 5).
#pragma once

#include <vector>

#include "core/association/association.h"
#include "core/contours/edge_elements.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// Replaces runs of `elements` and the lines that track them, in the same order, by arcs of at most `options.max_arc_px`
// in the view. TrackedLine::previous and next are indices into `lines` before and after. Elements of one
// TrackedLine::curve stay consecutive, and are in the order of their links.
void JoinArcs(const CameraModel& camera, const RigidTransform& camera_from_object, const EdgeElementOptions& options,
              std::vector<EdgeElement>& elements, std::vector<TrackedLine>& lines);

}  // namespace evpose
