// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/camera_picture.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>

#include "absl/strings/str_format.h"
#include "client/cli/pictures/png.h"
#include "core/numerics/math.h"

namespace evpose::client {
namespace {

// Colours, as blue, green and red.
const cv::Scalar kPaper(255, 255, 255);
const cv::Scalar kLineColour(178, 114, 0);
const cv::Scalar kCircleColour(0, 94, 213);
const cv::Scalar kInk(30, 30, 30);

constexpr int kSubPixelBits = 4;  // OpenCV draws at 1/16 px
constexpr int kMinWidth = 800;    // pixels of the picture; smaller sensors are enlarged
constexpr int kMaxDegrees = 85;   // the largest angle of kMaxFisheyeTangent (core/geometry/lens_models.h)
constexpr int kSamples = 400;     // number of points of a curve

class CameraPicture {
 public:
  explicit CameraPicture(const CameraModel& camera)
      : camera_(camera),
        scale_(std::max(1.0, std::ceil(static_cast<double>(kMinWidth) / camera.width_px))),
        image_(static_cast<int>(camera.height_px * scale_), static_cast<int>(camera.width_px * scale_), CV_8UC3,
               kPaper) {}

  // Draws the curve of the normalised points curve(s), 0 <= s <= 1, where the distortion can be inverted.
  void DrawCurve(const std::function<Eigen::Vector2d(double)>& curve, const cv::Scalar& colour) {
    std::vector<cv::Point> points;
    for (int i = 0; i <= kSamples; ++i) {
      const std::optional<cv::Point> pixel = PixelOf(curve(static_cast<double>(i) / kSamples));
      if (pixel) points.push_back(*pixel);
      if (pixel && i < kSamples) continue;
      cv::polylines(image_, points, false, colour, 1, cv::LINE_AA, kSubPixelBits);
      points.clear();
    }
  }

  void DrawText(const std::string& text, const cv::Point& at) {
    cv::putText(image_, text, at, cv::FONT_HERSHEY_SIMPLEX, 0.45, kPaper, 3, cv::LINE_AA);
    cv::putText(image_, text, at, cv::FONT_HERSHEY_SIMPLEX, 0.45, kInk, 1, cv::LINE_AA);
  }

  // Writes the angle beside its circle, on the right of the principal point.
  void LabelCircle(int degrees) {
    const std::optional<cv::Point> pixel = PixelOf({std::tan(degrees * kRadiansPerDegree), 0.0});
    if (pixel)
      DrawText(absl::StrFormat("%d", degrees), {(pixel->x >> kSubPixelBits) + 3, (pixel->y >> kSubPixelBits) - 3});
  }

  void DrawCentre() {
    const std::optional<cv::Point> pixel = PixelOf({0.0, 0.0});
    if (!pixel) return;
    const cv::Point centre(pixel->x >> kSubPixelBits, pixel->y >> kSubPixelBits);
    cv::drawMarker(image_, centre, kInk, cv::MARKER_CROSS, 20, 1, cv::LINE_AA);
  }

  const cv::Mat& image() const { return image_; }

 private:
  // Returns the point of the picture at a normalised point, in units of DrawCurve; nullopt beyond a fold of the
  // distortion or far outside.
  std::optional<cv::Point> PixelOf(const Eigen::Vector2d& point) const {
    const DistortedPoint distorted = DistortNormalised(camera_.lens_model, camera_.distortion, point);
    const double x = (camera_.fx_px * distorted.point.x() + camera_.cx_px + 0.5) * scale_;
    const double y = (camera_.fy_px * distorted.point.y() + camera_.cy_px + 0.5) * scale_;
    const double farthest = 4.0 * std::max(image_.cols, image_.rows);
    if (!distorted.is_regular || !(std::abs(x) < farthest && std::abs(y) < farthest)) return std::nullopt;
    return cv::Point(static_cast<int>(std::lround(x * (1 << kSubPixelBits))),
                     static_cast<int>(std::lround(y * (1 << kSubPixelBits))));
  }

  const CameraModel camera_;
  const double scale_;
  cv::Mat image_;
};

// Returns the angle between neighbouring lines: the largest step of the list for which half of the diagonal field of
// view has at least three lines.
double StepDegrees(const CameraModel& camera) {
  const double half_px = 0.5 * std::hypot(camera.width_px, camera.height_px);
  const double half_view = std::atan(half_px / camera.MaxFocalPx()) / kRadiansPerDegree;
  for (const double step : {10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02}) {
    if (half_view >= 3.0 * step) return step;
  }
  return 0.01;
}

}  // namespace

absl::StatusOr<std::string> DrawCamera(const CameraModel& camera) {
  CameraPicture picture(camera);
  const double step = StepDegrees(camera);
  const int count = static_cast<int>(kMaxDegrees / step);
  // The samples of a line are equally spaced in angle.
  const auto along = [](double s) { return std::tan((2.0 * s - 1.0) * (kMaxDegrees - 0.01) * kRadiansPerDegree); };
  const int num_lines = std::min(count, 60);
  for (int i = -num_lines; i <= num_lines; ++i) {
    const double at = std::tan(i * step * kRadiansPerDegree);
    picture.DrawCurve([&](double s) { return Eigen::Vector2d(at, along(s)); }, kLineColour);
    picture.DrawCurve([&](double s) { return Eigen::Vector2d(along(s), at); }, kLineColour);
  }
  for (int i = 1; i <= num_lines; ++i) {
    const double radius = std::tan(i * step * kRadiansPerDegree);
    picture.DrawCurve(
        [&](double s) {
          const double angle = 2.0 * std::numbers::pi * s;
          return Eigen::Vector2d(radius * std::cos(angle), radius * std::sin(angle));
        },
        kCircleColour);
    if (step >= 1.0) picture.LabelCircle(static_cast<int>(std::lround(i * step)));
  }
  picture.DrawCentre();
  picture.DrawText(absl::StrFormat("%dx%d px, %s lens, lines and circles every %g degrees", camera.width_px,
                                   camera.height_px, LensModelName(camera.lens_model), step),
                   {8, 20});
  return EncodePng(picture.image());
}

}  // namespace evpose::client
