// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/pose_comparison.h"

#include <algorithm>
#include <cmath>

#include "core/models/continuous_symmetry.h"

namespace evpose {
namespace {

double ReprojectionError(const ObjectModel& model, const CameraModel& camera, absl::Span<const VisibleSegment> visible,
                         const RigidTransform& truth, const RigidTransform& estimate) {
  const double diagonal_px = std::hypot(camera.width_px, camera.height_px);
  double sum_px = 0.0;
  for (const VisibleSegment& part : visible) {
    const ModelLine& line = model.lines[part.line];
    for (const double s : {part.begin, part.end}) {
      const Eigen::Vector3d point = line.p1 + s * (line.p2 - line.p1);
      const Eigen::Vector3d estimated = estimate * point;
      const double error_px =
          estimated.z() > 0.0 ? (camera.Project(estimated) - camera.Project(truth * point)).norm() : diagonal_px;
      sum_px += std::min(error_px, diagonal_px);
    }
  }
  return sum_px / (2.0 * static_cast<double>(std::max<size_t>(1, visible.size())));
}

}  // namespace

PoseError ComparePoses(const ObjectModel& model, const CameraModel& camera, absl::Span<const VisibleSegment> visible,
                       const RigidTransform& truth, const RigidTransform& estimate) {
  const RigidTransform nearest = NearestEquivalent(estimate, model, truth);
  PoseError error;
  error.rotation_rad = RotationAngle(nearest.rotation, truth.rotation);
  error.translation_ratio = (nearest.translation_m - truth.translation_m).norm() / truth.translation_m.z();
  error.reprojection_px = ReprojectionError(model, camera, visible, truth, nearest);
  return error;
}

}  // namespace evpose
