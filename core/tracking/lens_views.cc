// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/lens_views.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "core/geometry/rigid_transform.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// All angles are in radians. A view shows directions up to kReach from its axis, and more where it must be as large as
// the sensor. A border of the sensor beyond kReach gets another view, with its axis kFromBorder inside the border.
constexpr double kReach = 50.0 / kDegreesPerRadian;
constexpr double kFromBorder = 35.0 / kDegreesPerRadian;
// Largest distance of two axes in a row or column: halfway between them a pixel is stretched by 1 / cos^2 = 5 %.
constexpr double kSpacing = 25.0 / kDegreesPerRadian;
constexpr double kFarthestBorder = 85.0 / kDegreesPerRadian;

double Tangent(double angle) {
  const SinCos turn = DeterministicSinCos(angle);
  return turn.sin / turn.cos;
}

// The angle from the optical axis to a pixel of the border; the largest angle that is used if the lens shows more.
double BorderAngle(const CameraModel& camera, const Eigen::Vector2d& pixel) {
  const std::optional<Eigen::Vector2d> point =
      UndistortNormalised(camera.lens_model, camera.distortion, BearingOf(camera, pixel).head<2>());
  return point ? std::min(kFarthestBorder, DeterministicAtan2(point->norm(), 1.0)) : kFarthestBorder;
}

struct ViewAngle {
  double angle;
  bool is_searched;
};

// The angles of the axes along one axis of the image: from 0 towards the borders, in steps.
std::vector<ViewAngle> ViewAngles(double low, double high) {
  std::vector<ViewAngle> angles = {{0.0, true}};
  for (const auto& [border, sign] : {std::pair{high, 1.0}, {low, -1.0}}) {
    if (border <= kReach) continue;
    const double last = border - kFromBorder;
    const int steps = static_cast<int>(std::ceil(last / kSpacing));
    for (int step = 1; step <= steps; ++step) angles.push_back({sign * last * step / steps, step == steps});
  }
  return angles;
}

// The pixels of the sensor per radian at the axis of a view, in its directions x and y.
Eigen::Vector2d LocalFocalPx(const CameraModel& camera, const Eigen::Matrix3d& camera_from_view) {
  const Eigen::Vector3d axis = camera_from_view.col(2);
  const Eigen::Vector2d point = axis.head<2>() / axis.z();
  const DistortedPoint distorted = DistortNormalised(camera.lens_model, camera.distortion, point);
  Eigen::Vector2d focal_px;
  for (int i = 0; i < 2; ++i) {
    // The derivative of the normalised point by the angle.
    const Eigen::Vector3d step = camera_from_view.col(i);
    const Eigen::Vector2d moved = (step.head<2>() - step.z() * point) / axis.z();
    const double u_px = camera.fx_px * (distorted.xx * moved.x() + distorted.xy * moved.y());
    const double v_px = camera.fy_px * (distorted.xy * moved.x() + distorted.yy * moved.y());
    focal_px[i] = std::sqrt(u_px * u_px + v_px * v_px);
  }
  return focal_px;
}

struct Side {
  int size_px;
  double centre_px;
};

// Size and principal point of a view along one axis of the image: to the border of the lens, or kReach where that is
// farther. At least as large as the sensor, because events are tested against the size; the image then reaches farther
// on the side where the lens does.
Side SideOf(int sensor_px, double focal_px, double to_low, double to_high) {
  constexpr int kMaxSidePx = 4096;  // longest side of a valid camera
  const double low_px = focal_px * Tangent(std::min(to_low, kReach));
  const double high_px = focal_px * Tangent(std::min(to_high, kReach));
  const int size_px = std::clamp(static_cast<int>(std::ceil(low_px + high_px)), sensor_px, kMaxSidePx);
  const double extra_px = size_px - low_px - high_px;
  const bool is_low_free = to_low > kReach, is_high_free = to_high > kReach;
  const double low_share = is_low_free == is_high_free ? 0.5 : is_low_free ? 1.0 : 0.0;
  return {size_px, low_px + low_share * extra_px - 0.5};
}

}  // namespace

std::vector<LensView> MakeLensViews(const CameraModel& camera) {
  const double left = BorderAngle(camera, {-0.5, camera.cy_px});
  const double right = BorderAngle(camera, {camera.width_px - 0.5, camera.cy_px});
  const double top = BorderAngle(camera, {camera.cx_px, -0.5});
  const double bottom = BorderAngle(camera, {camera.cx_px, camera.height_px - 0.5});
  std::vector<LensView> views;
  for (const auto& [tilt, is_row_searched] : ViewAngles(top, bottom)) {      // downwards
    for (const auto& [pan, is_column_searched] : ViewAngles(left, right)) {  // to the right
      const Eigen::Matrix3d camera_from_view = ExpSo3({0.0, pan, 0.0}) * ExpSo3({-tilt, 0.0, 0.0});
      const Eigen::Vector3d axis = camera_from_view.col(2);
      // A corner that the lens does not show.
      if (!DistortNormalised(camera.lens_model, camera.distortion, axis.head<2>() / axis.z()).is_regular) continue;
      LensView view;
      view.view_from_camera = camera_from_view.transpose();
      view.is_searched = is_row_searched && is_column_searched;
      const Eigen::Vector2d focal_px = LocalFocalPx(camera, camera_from_view);
      view.camera.fx_px = focal_px.x();
      view.camera.fy_px = focal_px.y();
      const Side across = SideOf(camera.width_px, focal_px.x(), left + pan, right - pan);
      const Side down = SideOf(camera.height_px, focal_px.y(), top + tilt, bottom - tilt);
      view.camera.width_px = across.size_px;
      view.camera.height_px = down.size_px;
      view.camera.cx_px = across.centre_px;
      view.camera.cy_px = down.centre_px;
      views.push_back(view);
    }
  }
  return views;
}

}  // namespace evpose
