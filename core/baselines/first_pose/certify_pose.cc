// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/certify_pose.h"

#include <vector>

#include "core/initialization/rotation_count.h"

namespace evpose {

absl::StatusOr<RotationCertificate> CertifyPose(const ObjectModel& model, const CameraModel& camera,
                                                absl::Span<const ImageSegment> segments,
                                                const RigidTransform& camera_from_object,
                                                const RotationBnbOptions& options) {
  std::vector<Eigen::Vector3d> normals;
  for (const ImageSegment& segment : segments) {
    const Eigen::Vector3d normal = BackProjectedNormal(camera, segment);
    if (!normal.isZero()) normals.push_back(normal);
  }
  return CertifyRotation(normals, UniqueDirections(model), camera_from_object.rotation, options);
}

}  // namespace evpose
