// SPDX-License-Identifier: Apache-2.0

// The published objective as a witness for a pose that was found otherwise.
#pragma once

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/first_pose/rotation_bnb.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// Whether the rotation of a pose, of a PoseHypothesis for example, attains the global maximum of the published
// objective E (CertifyRotation; LOPET, Sec. III-B; core/initialization/README.md): no rotation makes more of the
// segments perpendicular to one of the model's directions. Segments without length count for nothing.
//
// kNotMaximum does not say that the pose is wrong: E sees neither which line is which nor where the lines end, it
// grants every segment the same angle however short it is, and with spurious segments its maximum is often elsewhere.
// kMaximum does not say that the pose is right: it is then one of those that explain the most directions.
//
// `camera`'s distortion plays no part: segments are undistorted. Errors, INVALID_ARGUMENT: options; no segment with a
// length; a model with fewer than two directions; a rotation that is none (to 1e-6).
absl::StatusOr<RotationCertificate> CertifyPose(const ObjectModel& model, const CameraModel& camera,
                                                absl::Span<const ImageSegment> segments,
                                                const RigidTransform& camera_from_object,
                                                const RotationBnbOptions& options = {});

}  // namespace evpose
