// SPDX-License-Identifier: Apache-2.0

// The visible edges of a tracked object, for display. They have no influence on poses.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/mesh/types/edge_curve.h"
#include "core/tracking/object/pose_estimate.h"

namespace evpose {

// The edges that the tracker has associated in the last window, and the pose that it has estimated.
struct ObjectOutline {
  struct Edge {
    Eigen::Vector3d p1;  // object frame, metres; of an arc, the ends of its TrackedLine, which lies beside its chord
    Eigen::Vector3d p2;
    Eigen::Vector3d sagitta;  // TrackedLine::sagitta
    EdgeKind kind = EdgeKind::kCrease;
  };
  TrackState state = TrackState::kInitializing;
  int64_t t_us = 0;  // sensor time of the pose
  RigidTransform camera_from_object;
  std::vector<Edge> edges;

  // Replaces `edges`.
  void SetEdges(absl::Span<const TrackedLine> lines);
};

struct OutlineSegment {
  Eigen::Vector2f p1_px = Eigen::Vector2f::Zero();  // pixels of the sensor, distortion included
  Eigen::Vector2f p2_px = Eigen::Vector2f::Zero();
  EdgeKind kind = EdgeKind::kCrease;
};

// Most segments of an outline: of one with more edges, the first ones are returned. Bounds memory.
inline constexpr size_t kMaxOutlineSegments = 2048;

// Projects the edges at the pose of the outline. `camera` is that of the session, also behind a fisheye lens, whose
// turned views the tracker uses. An arc, and a line that the lens bends, becomes several segments, which deviate from
// it by about 0.1 px at most. Parts behind the camera, parts that the lens model does not show, and parts more than
// the size of the image beside it are left out.
std::vector<OutlineSegment> ProjectOutline(const CameraModel& camera, const ObjectOutline& outline);

}  // namespace evpose
