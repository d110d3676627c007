// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/model_picture.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <vector>

#include "client/cli/pictures/png.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"
#include "core/evaluation/model_views.h"
#include "core/simulation/mesh_renderer.h"

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

// The surface alone, without a highlight: its edges are what the picture is about.
SceneOptions PictureScene() {
  SceneOptions scene;
  scene.finish = {.reflectance = 0.95, .specular_ratio = 0.0};
  scene.light.diffuse_ratio = 0.5;
  return scene;
}

double NearestDepthM(const ObjectModel& model, const RigidTransform& camera_from_object) {
  double nearest_m = std::numeric_limits<double>::infinity();
  for (const Eigen::Vector3d& vertex : model.vertices) {
    nearest_m = std::min(nearest_m, (camera_from_object * vertex).z());
  }
  return nearest_m;
}

// Draws the surface, shaded as in simulated recordings.
void DrawSurface(MeshRenderer& renderer, const RigidTransform& camera_from_object, cv::Mat& image) {
  constexpr float kWhite = 255.0f;
  renderer.Render(camera_from_object, 1.0);
  std::vector<float> picture(image.total(), 1.0f);
  renderer.CompositeOnto(picture);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const auto grey = cv::saturate_cast<uint8_t>(kWhite * picture[static_cast<size_t>(y) * image.cols + x]);
      image.at<cv::Vec3b>(y, x) = {grey, grey, grey};
    }
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
  std::optional<MeshRenderer> renderer;  // made for the first view: all have the same distance
  for (size_t i = 0; i < kDirections.size(); ++i) {
    EVPOSE_ASSIGN_OR_RETURN(const ModelView view,
                            ViewModelFrom(kDirections[i], model, camera, {.object_px = kObjectSize}));
    const int column = static_cast<int>(i) % kColumns, row = static_cast<int>(i) / kColumns;
    cv::Mat panel = image(cv::Rect(column * kViewSize, kHeaderHeight + row * kViewSize, kViewSize, kViewSize));
    if (!renderer) renderer.emplace(model, PictureScene(), camera, NearestDepthM(model, view.camera_from_object));
    DrawSurface(*renderer, view.camera_from_object, panel);
    DrawElements(view, camera, panel);
    WriteText(panel, Counted(view.elements.size(), "element"), {8, kViewSize - 10});
  }
  return EncodePng(image);
}

}  // namespace evpose::client
