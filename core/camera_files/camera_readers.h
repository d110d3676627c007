// SPDX-License-Identifier: Apache-2.0

// One reader for each format of camera files. `selection` is the camera's name in the file, empty if none was given.
// The camera is not yet validated.
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/camera_files/camera_file.h"
#include "core/camera_files/camera_tree.h"

namespace evpose {

// ROS camera_info, as camera_calibration writes it; the message as `rostopic echo` and `ros2 topic echo` print it.
bool IsRosMessage(const CameraFields& root);
absl::StatusOr<CameraFile> ReadRosMessage(const CameraFields& root);
absl::StatusOr<CameraFile> ReadRosCameraInfo(const CameraFields& root);

// Kalibr's camchain.yaml.
bool IsKalibr(const CameraFields& root);
absl::StatusOr<CameraFile> ReadKalibr(const CameraFields& root, const std::string& file, const std::string& selection);

// OpenCV's FileStorage, of which the files of Metavision, DV and ORB-SLAM are variants.
bool IsOpenCv(const CameraTree& tree, const CameraFields& root);
absl::StatusOr<CameraFile> ReadOpenCv(const CameraTree& tree, const CameraFields& root, const std::string& file,
                                      const std::string& selection);

// COLMAP's cameras.txt.
bool IsColmap(const std::string& text);
absl::StatusOr<CameraFile> ReadColmap(const std::string& text, const std::string& file, const std::string& selection);

// The name among `names` that is selected, or the only one. Error: the file has several, or not that one; it lists
// them.
absl::StatusOr<std::string> SelectCamera(const std::vector<std::string>& names, const std::string& file,
                                         const std::string& selection);
// Returns an error if a name was selected, for a file with one camera, which has no name.
absl::Status CheckNotSelected(const std::string& file, const std::string& selection);

}  // namespace evpose
