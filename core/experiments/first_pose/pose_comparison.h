// SPDX-License-Identifier: Apache-2.0

// An estimated pose against the true one, as every experiment with first poses counts it.
#pragma once

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"

namespace evpose {

inline constexpr double kRightRotationRad = 0.03490659;  // 2 deg
inline constexpr double kRightTranslationRatio = 0.02;   // of the depth

struct PoseError {
  double rotation_rad = 0.0;       // modulo the model's symmetries
  double translation_ratio = 0.0;  // distance between the positions, of the true depth
  // Mean over the ends of the visible parts of the lines; at most the image's diagonal each. 0 without any.
  double reprojection_px = 0.0;
  bool is_right() const { return rotation_rad <= kRightRotationRad && translation_ratio <= kRightTranslationRatio; }
};

// `visible`: the parts of the lines at the truth.
PoseError ComparePoses(const ObjectModel& model, const CameraModel& camera, absl::Span<const VisibleSegment> visible,
                       const RigidTransform& truth, const RigidTransform& estimate);

}  // namespace evpose
