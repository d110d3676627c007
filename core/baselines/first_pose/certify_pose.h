// SPDX-License-Identifier: Apache-2.0

// Certifies the rotation of a pose with the objective of the paper.
#pragma once

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/first_pose/rotation_bnb.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// Tests whether the rotation of a pose, for example of a PoseHypothesis, attains the global maximum of the objective E
// of the paper (CertifyRotation; LOPET, Sec. III-B; core/initialization/README.md): no rotation makes more of the
// segments perpendicular to a direction of the model. Segments of zero length are ignored.
//
// kNotMaximum does not mean that the pose is wrong: E considers neither which parallel line a segment belongs to nor
// the ends of the lines, allows the same angle for short and long segments, and with spurious segments its maximum is
// often at another rotation. kMaximum does not mean that the pose is right: it is one of those that explain the most
// segments by directions.
//
// Segments are undistorted, so that the distortion of `camera` is not used. INVALID_ARGUMENT: invalid options, no
// segment of positive length, a model with fewer than two directions, or a matrix that is not a rotation (to 1e-6).
absl::StatusOr<RotationCertificate> CertifyPose(const ObjectModel& model, const CameraModel& camera,
                                                absl::Span<const ImageSegment> segments,
                                                const RigidTransform& camera_from_object,
                                                const RotationBnbOptions& options = {});

}  // namespace evpose
