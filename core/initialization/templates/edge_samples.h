// SPDX-License-Identifier: Apache-2.0

// Points on the visible edges of an object at a pose.
#pragma once

#include <vector>

#include "core/association/visible_edges.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/search_views.h"

namespace evpose {

// Replaces `samples` by `count` points, or a few less, on the visible edges at the pose. They are as dense as events
// are expected to be: their number is proportional to the length in the image times the contrast.
void SampleVisibleEdges(const ModelEdges& edges, const CameraModel& camera, const RigidTransform& camera_from_object,
                        int count, std::vector<EdgeSample>& samples);

}  // namespace evpose
