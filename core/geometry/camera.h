// SPDX-License-Identifier: Apache-2.0

// Pinhole camera with plumb-bob distortion. Pixel (0, 0) is the centre of the top-left pixel.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/numerics/prefetch.h"

namespace evpose {

struct CameraModel {
  int width_px = 0;
  int height_px = 0;
  double fx_px = 0.0;
  double fy_px = 0.0;
  double cx_px = 0.0;
  double cy_px = 0.0;
  std::array<double, 5> distortion = {};  // k1 k2 p1 p2 k3

  bool operator==(const CameraModel&) const = default;

  // INVALID_ARGUMENT with the name of the first invalid field, as it is called in the camera file.
  absl::Status Validate() const;
  // Whether a lens may have these numbers: a field of view along the longer side of the image from 0.1 to 170 degrees,
  // and a principal point at most that side's length outside the image, as of a crop. With others, such as 1e300,
  // nothing can be tracked. Requires a valid camera. Errors: as Validate().
  absl::Status CheckView() const;

  // The larger of the two focal lengths (px): the largest image displacement per radian near the optical axis.
  double MaxFocalPx() const { return std::max(fx_px, fy_px); }

  // The undistorted pixel of a point in the camera frame (metres), whose z must be positive.
  Eigen::Vector2d Project(const Eigen::Vector3d& point_camera) const {
    return {fx_px * point_camera.x() / point_camera.z() + cx_px, fy_px * point_camera.y() / point_camera.z() + cy_px};
  }
  // The pixel on the sensor of an undistorted pixel: applies the distortion.
  Eigen::Vector2d Distort(const Eigen::Vector2d& undistorted_px) const;
  bool HasDistortion() const { return distortion != std::array<double, 5>{}; }
  // Whether an undistorted pixel is visible: the distortion is invertible there and maps it onto the sensor.
  bool IsInImage(const Eigen::Vector2d& undistorted_px) const;
};

// Bearing (x, y, 1) of an undistorted pixel.
inline Eigen::Vector3d BearingOf(const CameraModel& camera, const Eigen::Vector2d& pixel) {
  return {(pixel.x() - camera.cx_px) / camera.fx_px, (pixel.y() - camera.cy_px) / camera.fy_px, 1.0};
}

// Reads ROS camera_info YAML: image_width, image_height, camera_matrix, distortion_model (plumb_bob or none) and
// distortion_coefficients. Errors have the file and the field: those of ReadFile(), INVALID_ARGUMENT.
absl::StatusOr<CameraModel> LoadCameraModel(const std::string& path);
absl::StatusOr<CameraModel> ParseCameraModel(const std::string& yaml, const std::string& name_for_errors);
std::string CameraModelToYaml(const CameraModel& camera);

// The bearings of all pixels: (x, y) of K^-1 (u, v, 1) with the distortion removed. Memory: 4 bytes for each column and
// row of a camera without distortion, 8 bytes for each pixel of a camera with distortion.
class UndistortionTable {
 public:
  // Errors: INVALID_ARGUMENT for an invalid camera, or if the distortion cannot be inverted at some pixel.
  static absl::StatusOr<UndistortionTable> Create(const CameraModel& camera);

  // The first two components of the bearing (x, y, 1) of a pixel inside the sensor.
  Eigen::Vector2f Bearing(int x, int y) const {
    if (bearings_.empty()) return {columns_[x], rows_[y]};
    return bearings_[static_cast<size_t>(y) * columns_.size() + x];
  }
  // Prefetches the entry of Bearing(x, y). The pixel may lie outside the sensor.
  void Prefetch(int x, int y) const { PrefetchEntry(bearings_, static_cast<size_t>(y) * columns_.size() + x); }

 private:
  // The bearings without distortion: x by column, y by row.
  std::vector<float> columns_;
  std::vector<float> rows_;
  std::vector<Eigen::Vector2f> bearings_;  // with distortion, row by row; empty for a camera without distortion
};

}  // namespace evpose
