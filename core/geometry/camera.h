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

  // INVALID_ARGUMENT naming the field that is wrong.
  absl::Status Validate() const;

  // The larger of the two focal lengths: pixels per radian near the optical axis, at most.
  double MaxFocalPx() const { return std::max(fx_px, fy_px); }

  // Undistorted pixel of a point in the camera frame, metres; z must be positive.
  Eigen::Vector2d Project(const Eigen::Vector3d& point_camera) const {
    return {fx_px * point_camera.x() / point_camera.z() + cx_px, fy_px * point_camera.y() / point_camera.z() + cy_px};
  }
  // The sensor's own pixel of an undistorted pixel (applies the distortion).
  Eigen::Vector2d Distort(const Eigen::Vector2d& undistorted_px) const;
  bool HasDistortion() const { return distortion != std::array<double, 5>{}; }
  // Whether the sensor sees an undistorted pixel: its own pixel lies on it, and the lens does not fold the image there.
  bool IsInImage(const Eigen::Vector2d& undistorted_px) const;
};

// ROS camera_info YAML (image_width, image_height, camera_matrix, distortion_model plumb_bob or none,
// distortion_coefficients). Errors, each naming the file and the field: NOT_FOUND, INVALID_ARGUMENT.
absl::StatusOr<CameraModel> LoadCameraModel(const std::string& path);
absl::StatusOr<CameraModel> ParseCameraModel(const std::string& yaml, const std::string& name_for_errors);
std::string CameraModelToYaml(const CameraModel& camera);

// Undistorted, normalised bearings of all pixels: K^-1 (u, v, 1) with the distortion removed, as (x, y).
class UndistortionTable {
 public:
  // `camera` must be valid. Errors: INVALID_ARGUMENT when the distortion cannot be inverted inside the image.
  static absl::StatusOr<UndistortionTable> Create(const CameraModel& camera);

  // b = (x, y, 1) of the pixel; x and y inside the sensor.
  const Eigen::Vector2f& Bearing(int x, int y) const { return bearings_[static_cast<size_t>(y) * width_px_ + x]; }
  // Bearing(x, y) is about to be asked for.
  void Prefetch(int x, int y) const { PrefetchEntry(bearings_, static_cast<size_t>(y) * width_px_ + x); }

 private:
  int width_px_ = 0;
  std::vector<Eigen::Vector2f> bearings_;
};

}  // namespace evpose
