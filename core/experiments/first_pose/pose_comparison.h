// SPDX-License-Identifier: Apache-2.0

// Comparison of an estimated pose with the true one, common to all experiments with first poses.
#pragma once

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"

namespace evpose {

// Errors up to which a pose is right: 2 degrees, and 2 % of the depth. A tracker converges from a rotation error three
// times as large (start_cause.cc).
inline constexpr double kRightRotationRad = 0.03490659;  // 2 deg
inline constexpr double kRightTranslationRatio = 0.02;   // relative to the depth

struct PoseError {
  double rotation_rad = 0.0;       // modulo the symmetries of the model
  double translation_ratio = 0.0;  // distance between the positions, relative to the true depth
  // Mean over the ends of the visible parts of the lines, pixels; each is limited to the diagonal of the image. 0
  // without any.
  double reprojection_px = 0.0;
  bool is_right() const { return rotation_rad <= kRightRotationRad && translation_ratio <= kRightTranslationRatio; }
};

// Compares two poses, camera_from_object. `visible`: the visible parts of the lines at the true pose.
PoseError ComparePoses(const ObjectModel& model, const CameraModel& camera, absl::Span<const VisibleSegment> visible,
                       const RigidTransform& truth, const RigidTransform& estimate);

}  // namespace evpose
