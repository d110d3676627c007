// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/camera.h"

#include <cmath>

#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

// Twice the largest side that EVT3 can address, 2048 px. Bounds the undistortion table at 128 MiB, also for a file from
// an untrusted client.
constexpr int kMaxSidePx = 4096;

DistortedPoint Distorted(const CameraModel& camera, const Eigen::Vector2d& undistorted_px) {
  return DistortNormalised(camera.lens_model, camera.distortion, BearingOf(camera, undistorted_px).head<2>());
}

}  // namespace

absl::Status CameraModel::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("image_width", width_px, 1, kMaxSidePx));
  EVPOSE_RETURN_IF_ERROR(CheckRange("image_height", height_px, 1, kMaxSidePx));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("camera_matrix: fx", fx_px));
  EVPOSE_RETURN_IF_ERROR(CheckPositive("camera_matrix: fy", fy_px));
  if (!std::isfinite(cx_px)) return absl::InvalidArgumentError("camera_matrix: cx is not a finite number");
  if (!std::isfinite(cy_px)) return absl::InvalidArgumentError("camera_matrix: cy is not a finite number");
  if (lens_model > LensModel::kFisheye) return absl::InvalidArgumentError("distortion_model: is unknown");
  const int num_coefficients = NumCoefficients(lens_model);
  for (int i = 0; i < kMaxDistortion; ++i) {
    if (!std::isfinite(distortion[i])) {
      return absl::InvalidArgumentError("distortion_coefficients: every number must be finite");
    }
    if (i >= num_coefficients && distortion[i] != 0.0) {
      return absl::InvalidArgumentError(absl::StrFormat("distortion_coefficients: a %s lens has %d numbers",
                                                        LensModelName(lens_model), num_coefficients));
    }
  }
  return absl::OkStatus();
}

absl::Status CameraModel::CheckView() const {
  // Focal lengths relative to the longer side: 1 / (2 tan(view / 2)) for views of 170 and 0.1 degrees; of a fisheye
  // lens, 1 / view for 360 degrees, because lenses may look backwards. Only directions in front are used.
  const bool is_fisheye = lens_model == LensModel::kFisheye;
  const double min_focal = is_fisheye ? 0.159 : 0.0437;
  constexpr double kMaxFocal = 573.0;
  const double side_px = std::max(width_px, height_px);
  const auto check = [](const char* name, double value_px, double low_px, double high_px, const char* what) {
    if (value_px >= low_px && value_px <= high_px) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrFormat("camera_matrix: %s is %g px; with this image it must lie in [%g, %g]: %s", name, value_px,
                        low_px, high_px, what));
  };
  const char* const focal_rule = is_fisheye ? "a field of view of 0.1 to 360 degrees; give a calibration in pixels"
                                            : "a field of view of 0.1 to 170 degrees; give a calibration in pixels";
  constexpr char kCentreRule[] = "at most the longer side outside the image; give a calibration in pixels";
  EVPOSE_RETURN_IF_ERROR(check("fx", fx_px, min_focal * side_px, kMaxFocal * side_px, focal_rule));
  EVPOSE_RETURN_IF_ERROR(check("fy", fy_px, min_focal * side_px, kMaxFocal * side_px, focal_rule));
  EVPOSE_RETURN_IF_ERROR(check("cx", cx_px, -side_px, width_px + side_px, kCentreRule));
  return check("cy", cy_px, -side_px, height_px + side_px, kCentreRule);
}

Eigen::Vector2d CameraModel::Distort(const Eigen::Vector2d& undistorted_px) const {
  if (!HasDistortion()) return undistorted_px;
  const Eigen::Vector2d point = Distorted(*this, undistorted_px).point;
  return {fx_px * point.x() + cx_px, fy_px * point.y() + cy_px};
}

bool CameraModel::IsInImage(const Eigen::Vector2d& undistorted_px) const {
  const DistortedPoint distorted = Distorted(*this, undistorted_px);
  const double u_px = fx_px * distorted.point.x() + cx_px, v_px = fy_px * distorted.point.y() + cy_px;
  return distorted.is_regular && u_px >= -0.5 && u_px <= width_px - 0.5 && v_px >= -0.5 && v_px <= height_px - 0.5;
}

}  // namespace evpose
