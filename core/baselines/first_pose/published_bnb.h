// SPDX-License-Identifier: Apache-2.0

// First pose from lines without correspondences: the initialization of the paper, and a certificate by its objective.
#pragma once

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/baselines/first_pose/rotation_bnb.h"
#include "core/geometry/camera.h"
#include "core/geometry/image_segment.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// The defaults are validated by published_bnb_test, which requires a number of right poses; `evpose bench
// initialization` runs with them (core/experiments/RESULTS.md, The first pose).
struct PublishedBnbOptions {
  RotationBnbOptions rotation;
  // Pixels: largest distance of an end point from a projected line. The inlier band of 1.7 deg allows an error of the
  // rotation that displaces the end of an object of 250 px by 4 px.
  double threshold_px = 6.0;
  // Maximum number of triples of segments from which translations are computed. Each is combined with all assignments
  // of model lines with the right directions: 64 for a box, some thousands for a spacecraft.
  int max_triples = 20;

  // INVALID_ARGUMENT names the field.
  absl::Status Validate() const;
};

// LOPET (Liu, Guan, Shang, Yu, Kneip, IEEE TIP 2024), Sec. III-B: the rotation for which the most image lines are
// perpendicular to a direction of the model, by branch and bound; then the translation from the linear equations n_j .
// (R P_k + T) = 0.
//
// The paper assumes that the rotation determines the correspondences. It does not: parallel lines share a direction,
// and the count is equal for rotations that map the set of directions onto itself. Therefore each rotation that reaches
// the maximum (among those that the search returns) is combined with each of these symmetries, and the translations of
// triples of segments are enumerated for every assignment of lines with their directions. The translation with the most
// segments on projected lines is kept and solved again with all of them. The rotation remains the least-squares one of
// the inliers of the count; rotation and translation are not refined together, so that the result is that of the
// paper's objective. The search uses the bounds of rotation_bnb.h; the published ones find the same maximum in more
// time.
//
// Errors: INVALID_ARGUMENT for the options or a model without two directions; NOT_FOUND if no translation explains four
// segments.
absl::StatusOr<RigidTransform> EstimatePoseByPublishedBnb(const ObjectModel& model, const CameraModel& camera,
                                                          absl::Span<const ImageSegment> segments,
                                                          const PublishedBnbOptions& options);

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
