// SPDX-License-Identifier: Apache-2.0

// Points on the visible edges of an object at a pose.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "core/association/visible_edges.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

// A point on a visible edge. A point on a contour moves in the image, to first order, like one that is fixed to the
// object (core/contours/README.md, section 1).
struct EdgeSample {
  Eigen::Vector3d point;  // object frame, metres
  Eigen::Vector3d along;  // from the point along the edge, object frame: half the distance of neighbouring samples
  float prior_contrast = 1.0f;  // EdgeElement::prior_contrast
};

// Replaces `samples` by `count` points, or a few less, on the visible edges at the pose. They are as dense as events
// are expected to be: their number is proportional to the length in the image times the contrast.
void SampleVisibleEdges(const ModelEdges& edges, const CameraModel& camera, const RigidTransform& camera_from_object,
                        int count, std::vector<EdgeSample>& samples);

}  // namespace evpose
