// SPDX-License-Identifier: Apache-2.0

// Files of camera calibrations (README.md). Readers recognise the format by the content.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "core/geometry/camera.h"

namespace evpose {

struct CameraFile {
  CameraModel camera;
  std::string format;       // ros, ros-message, kalibr, metavision, opencv, colmap or dv
  std::string description;  // the format in words, and what else the file says: "Metavision intrinsics, RMS 0.21 px"
};

// Reads a file, or FILE#NAME: the camera of this name in a file with several. Errors have the file and the key: those
// of ReadFile(), INVALID_ARGUMENT. The camera is valid; CheckView() is left to the caller.
absl::StatusOr<CameraFile> ReadCameraFile(const std::string& path);
// The same for the content of a file, with the name for errors, and the name of the camera or "".
absl::StatusOr<CameraFile> ParseCameraFile(const std::string& text, const std::string& file,
                                           const std::string& selection = "");
// These return the camera of the file alone.
absl::StatusOr<CameraModel> LoadCameraModel(const std::string& path);
absl::StatusOr<CameraModel> ParseCameraModel(const std::string& text, const std::string& file);

enum class CameraFormat { kRos, kKalibr, kMetavision, kOpenCv };
// The content of a file, from which the same camera is read, to the bit. Error: INVALID_ARGUMENT if the format does not
// have the lens model, naming those that do.
absl::StatusOr<std::string> FormatCamera(const CameraModel& camera, CameraFormat format);
// ROS camera_info, which has all lens models.
std::string CameraModelToYaml(const CameraModel& camera);

}  // namespace evpose
