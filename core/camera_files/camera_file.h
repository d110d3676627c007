// SPDX-License-Identifier: Apache-2.0

// Files of camera calibrations.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "core/geometry/camera.h"

namespace evpose {

// Reads ROS camera_info YAML: image_width, image_height, camera_matrix, distortion_model (plumb_bob or none) and
// distortion_coefficients. Errors have the file and the field: those of ReadFile(), INVALID_ARGUMENT.
absl::StatusOr<CameraModel> LoadCameraModel(const std::string& path);
absl::StatusOr<CameraModel> ParseCameraModel(const std::string& yaml, const std::string& name_for_errors);
std::string CameraModelToYaml(const CameraModel& camera);

}  // namespace evpose
