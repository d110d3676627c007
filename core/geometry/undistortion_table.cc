// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/undistortion_table.h"

#include <Eigen/Geometry>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <optional>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/geometry/lens_models.h"

namespace evpose {
namespace {

// Largest distance between a pixel and the distorted projection of its bearing: far below the noise of an event.
constexpr double kMaxInversionErrorPx = 0.01;
// Bearing of a pixel beyond the largest angle of a fisheye lens, in units of the largest tangent: with any focal length
// it lies outside the image and its surroundings.
constexpr float kFarBeyond = 1e6F;

// Bearings of the pixels of row `v`, by OpenCV's fixed-point iteration in double precision.
absl::StatusOr<std::vector<cv::Point2d>> UndistortBrownRow(const CameraModel& camera, int v) {
  const cv::Matx33d k(camera.fx_px, 0, camera.cx_px, 0, camera.fy_px, camera.cy_px, 0, 0, 1);
  const auto& d = camera.distortion;
  const cv::Vec<double, 5> coefficients(d[0], d[1], d[2], d[3], d[4]);
  std::vector<cv::Point2d> pixels(camera.width_px);
  for (int u = 0; u < camera.width_px; ++u) pixels[u] = {static_cast<double>(u), static_cast<double>(v)};
  std::vector<cv::Point2d> bearings;
  try {
    // Far more iterations than a regular lens needs; IsInverse() checks the result.
    const cv::TermCriteria criteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 200, 1e-6);
    cv::undistortPoints(pixels, bearings, k, coefficients, cv::noArray(), cv::noArray(), criteria);
  } catch (const cv::Exception& e) {
    return absl::InternalError(absl::StrCat("distortion_coefficients: OpenCV: ", e.what()));
  }
  return bearings;
}

absl::Status CannotInvert(int u, int v) {
  return absl::InvalidArgumentError(
      absl::StrFormat("distortion_coefficients: the distortion cannot be inverted at pixel (%d, %d); "
                      "calibrate with points up to the image's corners",
                      u, v));
}

}  // namespace

// What is the same for all pixels of a camera.
struct UndistortionTable::LensLimits {
  explicit LensLimits(const CameraModel& camera)
      : second_branch(SecondBranchRadius(camera.lens_model, camera.distortion)) {
    if (camera.lens_model != LensModel::kFisheye) return;
    const DistortedPoint edge =
        DistortNormalised(camera.lens_model, camera.distortion, {kMaxFisheyeTangent * (1.0 - 1e-9), 0.0});
    if (edge.is_regular && second_branch > kMaxFisheyeTangent) edge_radius = edge.point.x();
  }

  // Whether `bearing` is the bearing of pixel (u, v): its distortion is that pixel, on the branch of the map around the
  // centre of the image (beyond a fold, two bearings have the same pixel).
  bool IsInverse(const CameraModel& camera, const Eigen::Vector2d& bearing, int u, int v) const {
    const DistortedPoint distorted = DistortNormalised(camera.lens_model, camera.distortion, bearing);
    const double error_x = distorted.point.x() * camera.fx_px + camera.cx_px - u;
    const double error_y = distorted.point.y() * camera.fy_px + camera.cy_px - v;
    return error_x * error_x + error_y * error_y <= kMaxInversionErrorPx * kMaxInversionErrorPx &&
           distorted.is_regular && bearing.norm() < second_branch;
  }
  // Whether the direction of a distorted point of a fisheye lens is beyond the largest angle, and not beyond a fold:
  // the distorted radius grows up to that angle, and the point is outside.
  bool IsBeyondLargestAngle(const Eigen::Vector2d& distorted) const { return distorted.norm() >= edge_radius; }
  // The same with a margin for points that UndistortNormalised() would invert within its tolerance. The search for the
  // bearings of all others would fail, after hundreds of evaluations of the lens for each pixel.
  bool IsFarBeyondLargestAngle(const Eigen::Vector2d& distorted) const {
    constexpr double kMargin = 1e-6;
    return distorted.norm() >= edge_radius + kMargin * (1.0 + distorted.norm());
  }

  double second_branch;
  // The distorted radius of the largest angle; infinity for lenses that do not show that angle.
  double edge_radius = std::numeric_limits<double>::infinity();
};

absl::Status UndistortionTable::AddDistortedRow(const CameraModel& camera, const LensLimits& limits, int v) {
  for (int u = 0; u < camera.width_px; ++u) {
    YieldPoint(static_cast<size_t>(u));
    const Eigen::Vector2d distorted = BearingOf(camera, Eigen::Vector2d(u, v)).head<2>();
    if (!limits.IsFarBeyondLargestAngle(distorted)) {
      const std::optional<Eigen::Vector2d> bearing =
          UndistortNormalised(camera.lens_model, camera.distortion, distorted);
      if (bearing && limits.IsInverse(camera, *bearing, u, v)) {
        bearings_.push_back(bearing->cast<float>());
        continue;
      }
      if (!limits.IsBeyondLargestAngle(distorted)) return CannotInvert(u, v);
    }
    bearings_.push_back(kFarBeyond * distorted.normalized().cast<float>());
  }
  return absl::OkStatus();
}

UndistortionTable UndistortionTable::Turned(const Eigen::Matrix3d& view_from_camera) const {
  UndistortionTable turned;
  turned.columns_ = columns_;
  turned.rows_ = rows_;
  turned.bearings_.reserve(columns_.size() * rows_.size());
  for (int y = 0; y < static_cast<int>(rows_.size()); ++y) {
    for (int x = 0; x < static_cast<int>(columns_.size()); ++x) {
      const Eigen::Vector3d direction = view_from_camera * Bearing(x, y).cast<double>().homogeneous();
      const double across = direction.head<2>().norm();
      const bool is_seen = direction.z() > 0.0 && across <= kMaxFisheyeTangent * direction.z();
      turned.bearings_.push_back(is_seen ? Eigen::Vector2f((direction.head<2>() / direction.z()).cast<float>())
                                         : Eigen::Vector2f(kFarBeyond, kFarBeyond));
    }
  }
  return turned;
}

absl::StatusOr<UndistortionTable> UndistortionTable::Create(const CameraModel& camera) {
  EVPOSE_RETURN_IF_ERROR(camera.Validate());
  UndistortionTable table;
  for (int u = 0; u < camera.width_px; ++u) {
    table.columns_.push_back(static_cast<float>((u - camera.cx_px) / camera.fx_px));
  }
  for (int v = 0; v < camera.height_px; ++v) {
    table.rows_.push_back(static_cast<float>((v - camera.cy_px) / camera.fy_px));
  }
  if (!camera.HasDistortion()) return table;
  table.bearings_.reserve(static_cast<size_t>(camera.width_px) * camera.height_px);
  const LensLimits limits(camera);
  for (int v = 0; v < camera.height_px; ++v) {
    if (camera.lens_model != LensModel::kBrown) {
      EVPOSE_RETURN_IF_ERROR(table.AddDistortedRow(camera, limits, v));
      continue;
    }
    YieldPoint();
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<cv::Point2d> row, UndistortBrownRow(camera, v));
    for (int u = 0; u < camera.width_px; ++u) {
      const Eigen::Vector2d bearing(row[u].x, row[u].y);
      if (!limits.IsInverse(camera, bearing, u, v)) return CannotInvert(u, v);
      table.bearings_.push_back(bearing.cast<float>());
    }
  }
  return table;
}

}  // namespace evpose
