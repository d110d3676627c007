// SPDX-License-Identifier: Apache-2.0

// The frame in which poses are written: --world-from-camera and --pose of the commands that write poses.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "client/cli/common/command.h"
#include "core/geometry/rigid_transform.h"
#include "evpose/types.h"

namespace evpose::client {

inline constexpr char kCameraFromObject[] = "camera_from_object";
inline constexpr char kObjectFromCamera[] = "object_from_camera";

class PoseFrame {
 public:
  PoseFrame() = default;  // camera_from_object, as in the API
  static PoseFrame ObjectFromCamera();
  // `frame` names the frame `world`, of which the name of the transform is made.
  static PoseFrame WorldFromObject(const RigidTransform& world_from_camera, const std::string& frame);

  // Name of the transform that is written, for example "world_from_object".
  const std::string& transform() const { return transform_; }
  bool is_default() const { return kind_ == Kind::kCamera; }
  // Everything that determines the output, for comparisons.
  std::string Description() const;

  // Returns the pose with all transforms, the covariance and the twist expressed as `transform()`
  // (core/geometry/README.md, section 5). Its field camera_from_object then holds that transform.
  Pose Apply(const Pose& pose) const;

 private:
  enum class Kind { kCamera, kObject, kWorld };
  RigidTransform Transformed(const RigidTransform& camera_from_object) const;

  Kind kind_ = Kind::kCamera;
  RigidTransform world_from_camera_;
  std::string transform_ = kCameraFromObject;
};

struct PoseFrameArguments {
  std::string world_from_camera;  // a file; empty: none
  std::string pose = "camera-from-object";

  void AddTo(CLI::App& app);
  // Errors: those of ReadTransformFile().
  absl::StatusOr<PoseFrame> Read() const;
};

}  // namespace evpose::client
