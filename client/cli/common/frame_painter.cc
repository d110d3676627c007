// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/frame_painter.h"

#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "absl/strings/str_format.h"

namespace evpose::client {
namespace {

// Colours, as blue, green and red.
const cv::Scalar kBackground(28, 24, 22);
const cv::Vec3b kOnColour(255, 190, 90);
const cv::Vec3b kOffColour(80, 90, 235);
const cv::Scalar kModelColour(110, 240, 110);
const cv::Scalar kTextColour(230, 230, 230);

constexpr int kSamplesPerSegment = 24;  // for lines that the distortion of the lens bends
constexpr int kSubPixelBits = 4;        // OpenCV draws at 1/16 px

}  // namespace

FramePainter::FramePainter(const CameraModel& camera, const ObjectModel& model)
    : camera_(camera), edges_(model, VisibilityOptions(), EdgeElementOptions()), visible_(camera, edges_) {
  Clear();
}

void FramePainter::Clear() {
  image_ = cv::Mat(camera_.height_px, camera_.width_px, CV_8UC3, kBackground);
  on_events_ = off_events_ = 0;
}

void FramePainter::DrawEvent(const Event& event) {
  if (event.x >= image_.cols || event.y >= image_.rows) return;
  image_.at<cv::Vec3b>(event.y, event.x) = event.polarity != 0 ? kOnColour : kOffColour;
  ++(event.polarity != 0 ? on_events_ : off_events_);
}

void FramePainter::DrawModel(const std::optional<RigidTransform>& camera_from_object) {
  if (!camera_from_object) return;
  for (const TrackedLine& line : visible_.At(*camera_from_object)) {
    std::vector<cv::Point> points;
    for (int i = 0; i <= kSamplesPerSegment; ++i) {
      const double share = static_cast<double>(i) / kSamplesPerSegment;
      const Eigen::Vector3d point = *camera_from_object * (line.p1 + share * (line.p2 - line.p1));
      if (point.z() <= 0.0) continue;
      const Eigen::Vector2d pixel = camera_.Distort(camera_.Project(point));
      points.emplace_back(static_cast<int>(std::lround(pixel.x() * (1 << kSubPixelBits))),
                          static_cast<int>(std::lround(pixel.y() * (1 << kSubPixelBits))));
    }
    cv::polylines(image_, points, false, kModelColour, 1, cv::LINE_AA, kSubPixelBits);
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
  const double scale = camera_.width_px >= 1000 ? 0.5 : 0.38;
  const int height = static_cast<int>(36 * scale);
  const cv::Point origin(8, height * (line + 1));
  cv::putText(image_, text, origin, cv::FONT_HERSHEY_SIMPLEX, scale, kBackground, 3, cv::LINE_AA);
  cv::putText(image_, text, origin, cv::FONT_HERSHEY_SIMPLEX, scale, kTextColour, 1, cv::LINE_AA);
}

}  // namespace evpose::client
