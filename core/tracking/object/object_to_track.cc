// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/object_to_track.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/association/other_objects.h"
#include "core/association/visible_edges.h"
#include "core/base/status_macros.h"
#include "core/initialization/check_lines.h"

namespace evpose {
namespace {

absl::Status CheckModel(const ObjectModel* model) {
  if (model == nullptr) return absl::InvalidArgumentError("the model is missing; give a model with edges");
  if (model->lines.empty() && !HasCurvedEdges(*model)) {
    return absl::InvalidArgumentError("the model has no line or curve to track; give a model with edges");
  }
  for (size_t k = 0; k < model->lines.size(); ++k) {
    if (!model->lines[k].p1.allFinite() || !model->lines[k].p2.allFinite()) {
      return absl::InvalidArgumentError(absl::StrCat("model line ", k, " has an end point that is not finite"));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status ObjectToTrack::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckModel(model.get()));
  if (edges != nullptr && &edges->model() != model.get()) {
    return absl::InvalidArgumentError("edges are those of another model; make them from the same one");
  }
  if (const absl::Status status = ValidateInitialPose(); !status.ok()) {
    return absl::InvalidArgumentError(absl::StrCat("initial_camera_from_object: ", status.message()));
  }
  if (!reference_rotation.allFinite() || !reference_rotation.isUnitary(1e-3) ||
      reference_rotation.determinant() < 0.0) {
    return absl::InvalidArgumentError("reference_rotation must be a rotation matrix");
  }
  return absl::OkStatus();
}

absl::Status ObjectToTrack::ValidateInitialPose() const {
  if (!initial_camera_from_object) return absl::OkStatus();
  const RigidTransform& pose = *initial_camera_from_object;
  if (!(pose.rotation.allFinite() && pose.translation_m.allFinite() && pose.translation_m.norm() > 1e-9)) {
    return absl::InvalidArgumentError("it must be finite, and its translation must not be zero");
  }
  const BoundingSphere sphere = BoundingSphereOf(*model);
  const double depth_m = (pose * sphere.centre).z();
  if (depth_m + sphere.radius_m > 0.0) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("the object is behind the camera, its centre at z = %.4g m; the z axis of the camera points away "
                      "from it, to the object",
                      depth_m));
}

}  // namespace evpose
