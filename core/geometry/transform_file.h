// SPDX-License-Identifier: Apache-2.0

// Files with one constant transform, such as the pose of a camera in the frame of a robot.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "core/geometry/rigid_transform.h"

namespace evpose {

struct NamedTransform {
  RigidTransform target_from_source;
  std::string target;  // name of the target frame; empty if the file does not have it
};

// Reads a file and recognises its form by its content; lines that begin with '#' are comments:
// - 7 numbers `tx ty tz qx qy qz qw`;
// - 16 numbers of a 4x4 matrix, row by row, also with brackets, commas and semicolons;
// - YAML or JSON with `translation` (a list or x, y, z) and `rotation` (a list of x, y, z, w, these keys, or a 3x3
//   matrix), or with the keys x, y, z, qx, qy, qz, qw, at the top or under `transform` (ROS TransformStamped) or
//   `transformation`. The name of the target frame, `frame_id`, at the top or under `header`, is optional.
// Translations are in metres. A rotation whose quaternion or columns have another norm than 1 is normalised if the
// difference is at most 1e-3. Errors name the file and the key: NOT_FOUND, PERMISSION_DENIED, INVALID_ARGUMENT.
absl::StatusOr<NamedTransform> ReadTransformFile(const std::string& path);
absl::StatusOr<NamedTransform> ParseTransform(const std::string& text, const std::string& name_for_errors);

// The YAML form, with 17 significant digits. `target` and `source` name the frames; `comment` is put before it.
std::string TransformToYaml(const RigidTransform& target_from_source, const std::string& target,
                            const std::string& source, const std::string& comment);

}  // namespace evpose
