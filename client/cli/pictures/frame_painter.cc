// SPDX-License-Identifier: Apache-2.0
#include "client/cli/pictures/frame_painter.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "absl/strings/str_format.h"

namespace evpose::client {
namespace {

// Colours, as blue, green and red.
const cv::Scalar kBackground(28, 24, 22);
const cv::Scalar kOnColour(255, 190, 90);
const cv::Scalar kOffColour(80, 90, 235);
const cv::Scalar kModelColour(110, 240, 110);
const cv::Scalar kTextColour(230, 230, 230);

constexpr int kSamplesPerSegment = 24;  // for lines that the distortion of the lens bends
constexpr int kSubPixelBits = 4;        // OpenCV draws at 1/16 px

// Pictures have at least this height, at which the text has the height of a line of a page.
constexpr int kLeastHeight = 480;
constexpr double kTextScale = 0.38;  // factor of OpenCV's font size, at that height
constexpr int kMargin = 8;

}  // namespace

FramePainter::FramePainter(const CameraModel& camera, const ObjectModel& model)
    : camera_(camera),
      scale_((kLeastHeight + camera.height_px - 1) / camera.height_px),
      edges_(model, VisibilityOptions(), EdgeElementOptions()),
      visible_(camera, edges_) {
  Clear();
}

void FramePainter::Clear() {
  image_ = cv::Mat(scale_ * camera_.height_px, scale_ * camera_.width_px, CV_8UC3, kBackground);
  on_events_ = off_events_ = 0;
}

void FramePainter::DrawEvent(const Event& event) {
  if (event.x >= camera_.width_px || event.y >= camera_.height_px) return;
  image_(cv::Rect(scale_ * event.x, scale_ * event.y, scale_, scale_)) = event.polarity != 0 ? kOnColour : kOffColour;
  ++(event.polarity != 0 ? on_events_ : off_events_);
}

double FramePainter::RelativeHeight() const { return static_cast<double>(image_.rows) / kLeastHeight; }

void FramePainter::DrawModel(const std::optional<RigidTransform>& camera_from_object) {
  if (!camera_from_object) return;
  const int thickness = std::max(1, static_cast<int>(RelativeHeight()));
  for (const TrackedLine& line : visible_.At(*camera_from_object)) {
    std::vector<cv::Point> points;
    for (int i = 0; i <= kSamplesPerSegment; ++i) {
      const double share = static_cast<double>(i) / kSamplesPerSegment;
      const Eigen::Vector3d point = *camera_from_object * (line.p1 + share * (line.p2 - line.p1));
      if (point.z() <= 0.0) continue;
      // The centre of the sensor's pixel 0 is that of its square in the picture.
      const Eigen::Vector2d pixel = scale_ * (camera_.Distort(camera_.Project(point)).array() + 0.5) - 0.5;
      points.emplace_back(static_cast<int>(std::lround(pixel.x() * (1 << kSubPixelBits))),
                          static_cast<int>(std::lround(pixel.y() * (1 << kSubPixelBits))));
    }
    cv::polylines(image_, points, false, kModelColour, thickness, cv::LINE_AA, kSubPixelBits);
  }
}

void FramePainter::DrawLegend(int64_t t_us, double window_ms, const std::optional<RigidTransform>& camera_from_object) {
  DrawText(absl::StrFormat("t %.6f s   window %g ms   %d ON   %d OFF", static_cast<double>(t_us) * 1e-6, window_ms,
                           on_events_, off_events_),
           0);
  if (!camera_from_object) {
    DrawText("no pose", 1);
    return;
  }
  const Eigen::Vector3d& t = camera_from_object->translation_m;
  const Eigen::Quaterniond q = camera_from_object->Quaternion();
  DrawText(absl::StrFormat("T %+.4f %+.4f %+.4f m   q %+.4f %+.4f %+.4f %+.4f", t.x(), t.y(), t.z(), q.x(), q.y(),
                           q.z(), q.w()),
           1);
}

void FramePainter::DrawText(const std::string& text, int line) {
  int baseline = 0;
  const double wanted = kTextScale * RelativeHeight();
  const cv::Size size = cv::getTextSize(text, cv::FONT_HERSHEY_SIMPLEX, wanted, 1, &baseline);
  // A picture that is higher than wide has smaller text.
  const double scale = wanted * std::min(1.0, static_cast<double>(image_.cols - 2 * kMargin) / size.width);
  const int thickness = std::max(1, static_cast<int>(scale / kTextScale));
  const cv::Point origin(kMargin, static_cast<int>(36.0 * wanted * (line + 1)));
  cv::putText(image_, text, origin, cv::FONT_HERSHEY_SIMPLEX, scale, kBackground, thickness + 2, cv::LINE_AA);
  cv::putText(image_, text, origin, cv::FONT_HERSHEY_SIMPLEX, scale, kTextColour, thickness, cv::LINE_AA);
}

}  // namespace evpose::client
