// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/views/lens_views.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/geometry/rigid_transform.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// Angles in radians. A view reaches 52 degrees from its axis on a sensor whose lens shows 75: farther borders have a
// view of their own, whose axis is 35 degrees from the border, so that an object beside the border is well inside.
constexpr double kReach = 50.0 / kDegreesPerRadian;
constexpr double kFromBorder = 35.0 / kDegreesPerRadian;
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

std::vector<double> ViewAngles(double low, double high) {
  std::vector<double> angles = {0.0};
  if (high > kReach) angles.push_back(high - kFromBorder);
  if (low > kReach) angles.push_back(kFromBorder - low);
  return angles;
}

// Pixels per radian in a direction, the geometric mean of those along the radius and across it.
double LocalFocalPx(const CameraModel& camera, const Eigen::Vector3d& axis) {
  const Eigen::Vector2d point = axis.head<2>() / axis.z();
  const DistortedPoint distorted = DistortNormalised(camera.lens_model, camera.distortion, point);
  const double determinant = distorted.xx * distorted.yy - distorted.xy * distorted.xy;
  // A radian is 1 + r^2 along the radius of the normalised plane, and sqrt(1 + r^2) across it.
  const double stretch = 1.0 + point.squaredNorm();
  return std::sqrt(camera.fx_px * camera.fy_px * std::max(determinant, 0.0) * stretch * std::sqrt(stretch));
}

// The principal point along one axis of the image, such that it does not exceed the borders.
double Centre(int size_px, double focal_px, double to_low, double to_high) {
  double centre = 0.5 * (size_px - 1);
  if (to_high < kFarthestBorder) centre = std::max(centre, size_px - 0.5 - focal_px * Tangent(to_high));
  if (to_low < kFarthestBorder) centre = std::min(centre, focal_px * Tangent(to_low) - 0.5);
  return centre;
}

}  // namespace

std::vector<LensView> MakeLensViews(const CameraModel& camera) {
  const double left = BorderAngle(camera, {-0.5, camera.cy_px});
  const double right = BorderAngle(camera, {camera.width_px - 0.5, camera.cy_px});
  const double top = BorderAngle(camera, {camera.cx_px, -0.5});
  const double bottom = BorderAngle(camera, {camera.cx_px, camera.height_px - 0.5});
  std::vector<LensView> views;
  for (const double tilt : ViewAngles(top, bottom)) {   // downwards
    for (const double pan : ViewAngles(left, right)) {  // to the right
      const Eigen::Matrix3d camera_from_view = ExpSo3({0.0, pan, 0.0}) * ExpSo3({-tilt, 0.0, 0.0});
      const Eigen::Vector3d axis = camera_from_view.col(2);
      // A corner that the lens does not show.
      if (!DistortNormalised(camera.lens_model, camera.distortion, axis.head<2>() / axis.z()).is_regular) continue;
      LensView view;
      view.view_from_camera = camera_from_view.transpose();
      view.camera.width_px = camera.width_px;
      view.camera.height_px = camera.height_px;
      view.camera.fx_px = view.camera.fy_px = LocalFocalPx(camera, axis);
      view.camera.cx_px = Centre(camera.width_px, view.camera.fx_px, left + pan, right - pan);
      view.camera.cy_px = Centre(camera.height_px, view.camera.fy_px, top + tilt, bottom - tilt);
      views.push_back(view);
    }
  }
  return views;
}

}  // namespace evpose
