// SPDX-License-Identifier: Apache-2.0

// Cameras: a pinhole with the distortion of a lens. Pixel (0, 0) is the centre of the top-left pixel.
#pragma once

#include <Eigen/Core>
#include <algorithm>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/geometry/lens_models.h"

namespace evpose {

struct CameraModel {
  int width_px = 0;
  int height_px = 0;
  double fx_px = 0.0;
  double fy_px = 0.0;
  double cx_px = 0.0;
  double cy_px = 0.0;
  Distortion distortion = {};
  LensModel lens_model = LensModel::kBrown;

  bool operator==(const CameraModel&) const = default;

  // INVALID_ARGUMENT with the name of the first invalid field, as it is called in the camera file.
  absl::Status Validate() const;
  // Returns an error if no lens has these numbers. The field of view along the longer side of the image must be from
  // 0.1 to 170 degrees, for a fisheye lens to 360 degrees, and the principal point at most that side's length outside
  // the image, as in a crop. With others, such as 1e300, nothing can be tracked. Requires a valid camera. Errors: as
  // Validate().
  absl::Status CheckView() const;

  // The larger of the two focal lengths (px): the largest image displacement per radian near the optical axis.
  double MaxFocalPx() const { return std::max(fx_px, fy_px); }

  // The undistorted pixel of a point in the camera frame (metres), whose z must be positive.
  Eigen::Vector2d Project(const Eigen::Vector3d& point_camera) const {
    return {fx_px * point_camera.x() / point_camera.z() + cx_px, fy_px * point_camera.y() / point_camera.z() + cy_px};
  }
  // The pixel on the sensor of an undistorted pixel: applies the distortion.
  Eigen::Vector2d Distort(const Eigen::Vector2d& undistorted_px) const;
  // Whether undistorted pixels differ from those on the sensor: a fisheye lens bends lines without coefficients, too.
  bool HasDistortion() const { return lens_model == LensModel::kFisheye || distortion != Distortion{}; }
  // The coefficients of the lens model.
  absl::Span<const double> Coefficients() const {
    return absl::MakeConstSpan(distortion).first(NumCoefficients(lens_model));
  }
  // Whether an undistorted pixel is visible: the distortion is invertible there and maps it onto the sensor.
  bool IsInImage(const Eigen::Vector2d& undistorted_px) const;
};

// Bearing (x, y, 1) of an undistorted pixel.
inline Eigen::Vector3d BearingOf(const CameraModel& camera, const Eigen::Vector2d& pixel) {
  return {(pixel.x() - camera.cx_px) / camera.fx_px, (pixel.y() - camera.cy_px) / camera.fy_px, 1.0};
}

}  // namespace evpose
