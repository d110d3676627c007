// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/model_picture.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "client/cli/pictures/png.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"
#include "core/evaluation/model_views.h"

namespace evpose::client {
namespace {

// Pixels.
constexpr int kViewSize = 480;
constexpr int kHeaderHeight = 56;
constexpr double kObjectSize = 380.0;
// Fractions of a pixel in the coordinates of drawn shapes, as a power of two.
constexpr int kShift = 4;

// Directions from the object to the camera.
const std::array<Eigen::Vector3d, 6> kDirections = {Eigen::Vector3d(1.0, -0.6, 0.6), Eigen::Vector3d(0.6, 1.0, 0.6),
                                                    Eigen::Vector3d(-1.0, 0.6, 0.6), Eigen::Vector3d(-0.6, -1.0, -0.6),
                                                    Eigen::Vector3d(0.0, 0.0, 1.0),  Eigen::Vector3d(0.0, 0.0, -1.0)};

struct EdgeStyle {
  evpose::EdgeKind kind;
  const char* name;
  cv::Scalar color;  // blue, green, red: of Okabe and Ito, which colour-blind people can distinguish
};
const std::array<EdgeStyle, 4> kEdgeStyles = {{{evpose::EdgeKind::kContour, "contour", {0, 94, 213}},
                                               {evpose::EdgeKind::kCrease, "crease", {178, 114, 0}},
                                               {evpose::EdgeKind::kBoundary, "boundary", {115, 158, 0}},
                                               {evpose::EdgeKind::kPainted, "painted line", {167, 121, 204}}}};

const cv::Scalar& ColorOf(evpose::EdgeKind kind) {
  return std::find_if(kEdgeStyles.begin(), kEdgeStyles.end(), [kind](const EdgeStyle& s) { return s.kind == kind; })
      ->color;
}

void WriteText(cv::Mat& image, const std::string& text, cv::Point at, double scale = 0.45) {
  cv::putText(image, text, at, cv::FONT_HERSHEY_SIMPLEX, scale, {30, 30, 30}, 1, cv::LINE_AA);
}

CameraModel PictureCamera() {
  return {.width_px = kViewSize,
          .height_px = kViewSize,
          .fx_px = 3.0 * kViewSize,  // a long focal length: little perspective, as in a drawing
          .fy_px = 3.0 * kViewSize,
          .cx_px = 0.5 * (kViewSize - 1),
          .cy_px = 0.5 * (kViewSize - 1)};
}

cv::Point FixedPoint(const Eigen::Vector2d& pixel) {
  return {cvRound(pixel.x() * (1 << kShift)), cvRound(pixel.y() * (1 << kShift))};
}

// Draws the faces from the farthest to the nearest, brighter where they face the camera.
void DrawFaces(const ObjectModel& model, const RigidTransform& camera_from_object, const CameraModel& camera,
               cv::Mat& image) {
  std::vector<std::pair<double, size_t>> by_depth;
  for (size_t i = 0; i < model.triangles.size(); ++i) {
    const auto& [a, b, c] = model.triangles[i];
    const Eigen::Vector3d middle = (model.vertices[a] + model.vertices[b] + model.vertices[c]) / 3.0;
    by_depth.emplace_back((camera_from_object * middle).z(), i);
  }
  std::sort(by_depth.rbegin(), by_depth.rend());
  for (const auto& [depth_m, i] : by_depth) {
    std::array<Eigen::Vector3d, 3> corners;
    std::vector<cv::Point> outline;
    for (int k = 0; k < 3; ++k) {
      corners[k] = camera_from_object * model.vertices[model.triangles[i][k]];
      outline.push_back(FixedPoint(camera.Project(corners[k])));
    }
    const Eigen::Vector3d normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalized();
    const double grey = 150.0 + 90.0 * std::abs(normal.dot(corners[0].normalized()));
    cv::fillConvexPoly(image, outline, {grey, grey, grey}, cv::LINE_AA, kShift);
  }
}

void DrawElements(const ModelView& view, const CameraModel& camera, cv::Mat& image) {
  for (const TrackedLine& element : view.elements) {
    cv::line(image, FixedPoint(camera.Project(view.camera_from_object * element.p1)),
             FixedPoint(camera.Project(view.camera_from_object * element.p2)), ColorOf(element.kind), 2, cv::LINE_AA,
             kShift);
  }
}

}  // namespace

absl::StatusOr<std::string> DrawModel(const ObjectModel& model, const std::string& title) {
  constexpr int kColumns = 3, kRows = 2;  // one view for each of kDirections
  cv::Mat image(kHeaderHeight + kRows * kViewSize, kColumns * kViewSize, CV_8UC3, cv::Scalar(255, 255, 255));
  WriteText(image, title, {16, 22}, 0.55);
  for (size_t i = 0; i < kEdgeStyles.size(); ++i) {
    const int x = 16 + 180 * static_cast<int>(i);
    cv::line(image, {x, 42}, {x + 40, 42}, kEdgeStyles[i].color, 2, cv::LINE_AA);
    WriteText(image, kEdgeStyles[i].name, {x + 50, 47});
  }
  const CameraModel camera = PictureCamera();
  for (size_t i = 0; i < kDirections.size(); ++i) {
    EVPOSE_ASSIGN_OR_RETURN(const ModelView view,
                            ViewModelFrom(kDirections[i], model, camera, {.object_px = kObjectSize}));
    const int column = static_cast<int>(i) % kColumns, row = static_cast<int>(i) / kColumns;
    cv::Mat panel = image(cv::Rect(column * kViewSize, kHeaderHeight + row * kViewSize, kViewSize, kViewSize));
    DrawFaces(model, view.camera_from_object, camera, panel);
    DrawElements(view, camera, panel);
    WriteText(panel, Counted(view.elements.size(), "element"), {8, kViewSize - 10});
  }
  return EncodePng(image);
}

}  // namespace evpose::client
