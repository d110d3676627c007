// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/pose_frame.h"

#include "absl/strings/str_cat.h"
#include "client/lib/core_types.h"
#include "core/base/status_macros.h"
#include "core/geometry/transform_file.h"

namespace evpose::client {

PoseFrame PoseFrame::ObjectFromCamera() {
  PoseFrame frame;
  frame.kind_ = Kind::kObject;
  frame.transform_ = kObjectFromCamera;
  return frame;
}

PoseFrame PoseFrame::WorldFromObject(const RigidTransform& world_from_camera, const std::string& name) {
  PoseFrame frame;
  frame.kind_ = Kind::kWorld;
  frame.world_from_camera_ = world_from_camera;
  frame.transform_ = absl::StrCat(name, "_from_object");
  return frame;
}

std::string PoseFrame::Description() const {
  if (kind_ != Kind::kWorld) return transform_;
  return TransformToYaml(world_from_camera_, transform_, "camera", "");
}

RigidTransform PoseFrame::Transformed(const RigidTransform& camera_from_object) const {
  if (kind_ == Kind::kObject) return camera_from_object.Inverse();
  return world_from_camera_ * camera_from_object;
}

Pose PoseFrame::Apply(const Pose& pose) const {
  if (is_default()) return pose;
  const RigidTransform camera_from_object = ToCore(pose.camera_from_object);
  const Matrix6d jacobian =
      kind_ == Kind::kObject ? JacobianOfInverse(camera_from_object) : JacobianOfProduct(world_from_camera_.rotation);
  Pose result = pose;
  result.camera_from_object = FromCore(Transformed(camera_from_object));
  result.covariance = jacobian * pose.covariance * jacobian.transpose();
  result.covariance = (0.5 * (result.covariance + result.covariance.transpose())).eval();  // symmetric to the bit
  result.twist = jacobian * pose.twist;
  for (PoseAlternative& alternative : result.alternatives) {
    alternative.camera_from_object = FromCore(Transformed(ToCore(alternative.camera_from_object)));
  }
  return result;
}

void PoseFrameArguments::AddTo(CLI::App& app) {
  CLI::Option* const world =
      AddFile(app, "--world-from-camera", world_from_camera,
              "Constant pose of the camera in a world or robot frame: \"tx ty tz qx qy qz qw\", a 4x4 matrix, or YAML "
              "with translation and rotation, metres. Poses, covariances and twists are written in that frame");
  AddOption(app, "--pose", pose,
            "The transform that is written. object-from-camera is the pose of a moving camera in the frame of an "
            "object at rest",
            CLI::IsMember({"camera-from-object", "object-from-camera"}))
      ->excludes(world);
}

absl::StatusOr<PoseFrame> PoseFrameArguments::Read() const {
  if (pose == "object-from-camera") return PoseFrame::ObjectFromCamera();
  if (world_from_camera.empty()) return PoseFrame();
  EVPOSE_ASSIGN_OR_RETURN(const NamedTransform world, ReadTransformFile(world_from_camera));
  return PoseFrame::WorldFromObject(world.target_from_source, world.target.empty() ? "world" : world.target);
}

}  // namespace evpose::client
