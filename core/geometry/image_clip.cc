// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/image_clip.h"

#include <algorithm>

namespace evpose {
namespace {

// Margin around the image, relative to its larger side, from which lens distortion may move a point into the image. A
// larger margin keeps lines that no lens shows, a smaller one cuts lines at the border of the image of a wide lens.
constexpr double kDistortionMargin = 0.5;

// Restricts the interval to the parameters s with value1 + s (value2 - value1) >= 0.
void Clip(double value1, double value2, LineInterval& interval) {
  if (value1 >= 0.0 && value2 >= 0.0) return;
  if (value1 < 0.0 && value2 < 0.0) {
    interval.end = interval.begin;
    return;
  }
  const double crossing = value1 / (value1 - value2);
  if (value1 < 0.0) {
    interval.begin = std::max(interval.begin, crossing);
  } else {
    interval.end = std::min(interval.end, crossing);
  }
}

}  // namespace

// The conditions are linear in the line's parameter (core/models/README.md, equation (3)).
LineInterval ClipToImage(const CameraModel& camera, const Eigen::Vector3d& p1, const Eigen::Vector3d& p2) {
  LineInterval interval;
  Clip(p1.z() - kClipDepthM, p2.z() - kClipDepthM, interval);
  // The undistorted image of a fisheye lens extends to the largest angle that is used.
  const double margin_px = camera.lens_model == LensModel::kFisheye ? kMaxFisheyeTangent * camera.MaxFocalPx()
                           : camera.HasDistortion() ? kDistortionMargin * std::max(camera.width_px, camera.height_px)
                                                    : 0;
  const double left = -0.5 - margin_px, right = camera.width_px - 0.5 + margin_px;
  const double top = -0.5 - margin_px, bottom = camera.height_px - 0.5 + margin_px;
  const auto u = [&](const Eigen::Vector3d& p, double bound) {
    return camera.fx_px * p.x() + (camera.cx_px - bound) * p.z();
  };
  const auto v = [&](const Eigen::Vector3d& p, double bound) {
    return camera.fy_px * p.y() + (camera.cy_px - bound) * p.z();
  };
  Clip(u(p1, left), u(p2, left), interval);
  Clip(-u(p1, right), -u(p2, right), interval);
  Clip(v(p1, top), v(p2, top), interval);
  Clip(-v(p1, bottom), -v(p2, bottom), interval);
  return interval;
}

}  // namespace evpose
