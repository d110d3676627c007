// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/renderer.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/numerics/math.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Length of the pieces, pixels, into which edges are divided, because distortion bends them. Over one piece the
// deviation from a straight line is far below 0.01 px for usual lenses (plumb-bob model).
constexpr double kPiecePx = 12.0;
// The oscillation of a texture that moves. kTextureSwing: amplitude along x, as a share of the image's width. The
// others are the ratios of the amplitude and of the frequency along y to those along x. With a frequency ratio that is
// no simple fraction, the direction of the motion changes all the time, so that edges of all directions emit events.
constexpr double kTextureSwing = 0.1;
constexpr double kTextureSwingYToX = 0.6;
constexpr double kTextureCyclesYToX = 0.73;
constexpr double kNearM = 1e-3;  // metres; smallest depth of a projected point

// Returns the value of an oscillation, in [-1, 1].
double Swing(double cycles) { return DeterministicSinCos(2.0 * std::numbers::pi * (cycles - std::floor(cycles))).sin; }

// Returns the frequency of a sine with this amplitude and mean speed; it covers four amplitudes in a period.
double SwingHz(double speed_px_per_s, double amplitude_px) { return speed_px_per_s / (4.0 * amplitude_px); }

PixelRect ShapesRect(const auto& shapes) {
  PixelRect rect;
  for (const auto& shape : shapes) rect = rect.Union(BoundingRect(shape.points_px));
  return rect;
}

}  // namespace

SceneRenderer::SceneRenderer(const SceneOptions& options, const SceneObject& object, const CameraModel& camera,
                             uint64_t seed)
    : options_(options),
      object_(object),
      camera_(camera),
      image_{0, 0, camera.width_px, camera.height_px},
      rasterizer_(camera.width_px, camera.height_px),
      blur_(options.lens_blur_px),
      background_(static_cast<size_t>(camera.width_px) * camera.height_px),
      sharp_(background_.size()),
      picture_(background_.size()) {
  texture_ = MakeTexture(seed);
  PaintBackground(0.0);
  if (options.model != nullptr) {
    const double nearest_m = options.motion.depth_m * (1.0 - options.motion.depth_swing_ratio) - object.radius_m;
    mesh_ = std::make_unique<MeshRenderer>(*options.model, options, camera, nearest_m);
  }
}

std::vector<SceneRenderer::Shape> SceneRenderer::MakeTexture(uint64_t seed) const {
  const BackgroundOptions& options = options_.background;
  std::vector<Shape> shapes;
  if (!options.is_textured) return shapes;
  Random random(seed);
  // A texture that moves extends beyond the image, by as much as it is displaced.
  const double margin_px = IsTextureMoving() ? kTextureSwing * image_.x1 : 0.0;
  for (int i = 0; i < options.texture_rectangles; ++i) {  // of 2 to 16 % of the image's width
    // First: the order of arguments depends on the compiler.
    const double y = random.Uniform(-margin_px, image_.y1 + margin_px);
    const Vector2d centre(random.Uniform(-margin_px, image_.x1 + margin_px), y);
    const SinCos turn = DeterministicSinCos(random.Uniform(0.0, std::numbers::pi));
    const Vector2d u = Vector2d(turn.cos, turn.sin) * random.Uniform(0.01, 0.08) * image_.x1;
    const Vector2d v = Vector2d(turn.sin, -turn.cos) * random.Uniform(0.01, 0.08) * image_.x1;
    const double shade =
        options.reflectance * random.Uniform(1.0 - options.texture_contrast, 1.0 + options.texture_contrast);
    shapes.push_back({{centre - u - v, centre + u - v, centre + u + v, centre - u + v}, shade, 1.0});
  }
  return shapes;
}

bool SceneRenderer::IsTextureMoving() const {
  return options_.background.is_textured && options_.background.texture_speed_px_per_s > 0.0;
}

Vector2d SceneRenderer::TextureShiftPx(double t_s) const {
  if (!IsTextureMoving()) return Vector2d::Zero();
  const double amplitude_px = kTextureSwing * image_.x1;
  const double cycles = SwingHz(options_.background.texture_speed_px_per_s, amplitude_px) * t_s;
  return amplitude_px * Vector2d(Swing(cycles), kTextureSwingYToX * Swing(kTextureCyclesYToX * cycles));
}

void SceneRenderer::PaintBackground(double t_s) {
  std::fill(sharp_.begin(), sharp_.end(), static_cast<float>(options_.background.reflectance));
  const Vector2d shift_px = TextureShiftPx(t_s);
  for (Shape shape : texture_) {
    for (Vector2d& point : shape.points_px) point += shift_px;
    Composite({shape});
  }
  background_ = sharp_;
  if (!options_.background.has_moving_edge) return;
  edgeless_ = background_;
  last_edge_x_px_.reset();  // the edge is painted over the whole image
}

double SceneRenderer::LightAt(double t_s) const {
  const LightOptions& light = options_.light;
  const double flicker = 1.0 + light.flicker_depth * Swing(light.flicker_hz * t_s);
  // The light starts at 1 and is darkest after half a period.
  const double darkness = 0.5 * (1.0 - Swing(t_s / light.change_period_s + 0.25));
  return flicker / (1.0 + (light.change_ratio - 1.0) * darkness);
}

double SceneRenderer::LongestStepS() const {
  constexpr double kAtRestS = 2e-3;  // without motion and changes of the light; such a step takes little time
  double longest = kAtRestS;
  if (options_.light.flicker_depth > 0.0) {
    // With n pictures per cycle, linear interpolation of a sine has an error of (2 pi / n)^2 / 8 of its amplitude. The
    // tolerance is 0.15 % of the light, half a per cent of a usual threshold.
    constexpr double kTolerance = 0.0015;
    const double steps = 2.0 * std::numbers::pi * std::sqrt(options_.light.flicker_depth / (8.0 * kTolerance));
    longest = std::min(longest, 1.0 / (std::max(steps, 8.0) * options_.light.flicker_hz));
  }
  if (options_.light.change_ratio > 1.0) longest = std::min(longest, options_.light.change_period_s / 200.0);
  return longest;
}

std::vector<Vector2d> SceneRenderer::ProjectOutline(const std::vector<Vector3d>& outline_object,
                                                    const RigidTransform& camera_from_object) const {
  std::vector<Vector2d> corners;
  for (const Vector3d& p : outline_object) {
    Vector3d point = camera_from_object * p;
    point.z() = std::max(point.z(), kNearM);  // protects the division; MotionPath keeps objects in front of the camera
    corners.push_back(camera_.Project(point));
  }
  if (!camera_.HasDistortion()) return corners;
  std::vector<Vector2d> bent;
  for (size_t i = 0; i < corners.size(); ++i) {
    const Vector2d& from = corners[i];
    const Vector2d& to = corners[i + 1 == corners.size() ? 0 : i + 1];
    const int pieces = 1 + static_cast<int>(std::min((to - from).norm() / kPiecePx, 1000.0));
    for (int k = 0; k < pieces; ++k) bent.push_back(camera_.Distort(from + (to - from) * (1.0 * k / pieces)));
  }
  return bent;
}

std::vector<SceneRenderer::Shape> SceneRenderer::BodyShapes(const Body& body, const RigidTransform& camera_from_object,
                                                            double light) const {
  std::vector<Shape> shapes;
  const double diffuse_ratio = options_.light.diffuse_ratio;
  const Vector3d light_direction = LightDirectionCamera();
  for (const Surface& surface : body.surfaces) {
    const Vector3d normal = camera_from_object.rotation * surface.normal;
    if (normal.dot(camera_from_object * surface.outline[0]) >= 0.0) continue;  // faces away from the camera
    const double lit = std::max(0.0, normal.dot(light_direction));
    const double shade = light * (1.0 - diffuse_ratio + diffuse_ratio * lit);
    shapes.push_back({ProjectOutline(surface.outline, camera_from_object), shade * surface.reflectance, 1.0});
    for (const Paint& paint : surface.paints) {
      const double difference = shade * (paint.reflectance - paint.under);
      shapes.push_back({ProjectOutline(paint.outline, camera_from_object), difference, 0.0});
    }
  }
  return shapes;
}

double SceneRenderer::OccluderX(const RigidTransform& camera_from_object, double t_s) const {
  const OccluderOptions& options = options_.occluder;
  const double amplitude_px = options.swing_ratio * camera_.width_px;
  // The phase of 0.6 cycles places the bar on the left of the centre at the start.
  const double swing_px = amplitude_px * Swing(SwingHz(options.speed_px_per_s, amplitude_px) * t_s + 0.6);
  if (!options.follows_object) return 0.5 * camera_.width_px + swing_px;
  Vector3d centre = camera_from_object * object_.centre_m;
  centre.z() = std::max(centre.z(), kNearM);
  const Vector2d place = camera_.Distort(camera_.Project(centre));
  // The bar is tilted; this is its position in the row of the image's centre.
  return place.x() - options.tilt_ratio * (place.y() - 0.5 * camera_.height_px) + swing_px;
}

double SceneRenderer::EdgeX(double t_s) const {
  const double amplitude_px = 0.5 * camera_.width_px;
  const double frequency_hz = SwingHz(options_.background.edge_speed_px_per_s, amplitude_px);
  return 0.5 * camera_.width_px + amplitude_px * Swing(frequency_hz * t_s + 0.35);
}

PixelRect SceneRenderer::MoveBackgroundEdge(double t_s) {
  if (edgeless_.empty()) return {};
  const double x = EdgeX(t_s);
  const double middle_y = 0.5 * camera_.height_px;
  const double half_height = middle_y + 8.0;  // the polygon ends outside the image
  const double lean = options_.background.edge_tilt_ratio * half_height;
  const double far_x = 2.0 * camera_.width_px + std::abs(lean);
  const Shape shape = {{{x - lean, middle_y - half_height},
                        {x + lean, middle_y + half_height},
                        {far_x, middle_y + half_height},
                        {far_x, middle_y - half_height}},
                       options_.background.edge_reflectance,
                       1.0};
  PixelRect rect = image_;
  if (last_edge_x_px_) {
    rect.x0 = static_cast<int>(std::floor(std::min(x, *last_edge_x_px_) - std::abs(lean))) - 1;
    rect.x1 = static_cast<int>(std::ceil(std::max(x, *last_edge_x_px_) + std::abs(lean))) + 2;
    rect = rect.Intersection(image_);
  }
  last_edge_x_px_ = x;
  if (rect.empty()) return rect;
  for (int y = rect.y0; y < rect.y1; ++y) {
    const auto row = static_cast<std::ptrdiff_t>(y) * image_.x1;
    std::copy(edgeless_.begin() + row + rect.x0, edgeless_.begin() + row + rect.x1,
              background_.begin() + row + rect.x0);
  }
  rasterizer_.Begin(rect);
  rasterizer_.AddPolygon(shape.points_px, shape.value, shape.alpha);
  rasterizer_.CompositeOnto(background_);
  return rect;
}

std::vector<SceneRenderer::Shape> SceneRenderer::OccluderShapes(const RigidTransform& camera_from_object,
                                                                double t_s) const {
  const OccluderOptions& options = options_.occluder;
  if (!options.is_present) return {};
  const double x = OccluderX(camera_from_object, t_s);
  const double half_height = 0.5 * camera_.height_px + 8.0;  // the polygon ends outside the image
  const double lean = options.tilt_ratio * half_height;
  const double middle_y = 0.5 * camera_.height_px;
  const Vector2d top(x - lean, middle_y - half_height);
  const Vector2d bottom(x + lean, middle_y + half_height);
  const Vector2d half_width(0.5 * options.width_px, 0.0);
  return {{{top - half_width, bottom - half_width, bottom + half_width, top + half_width}, options.reflectance, 1.0}};
}

void SceneRenderer::Composite(const std::vector<Shape>& shapes) {
  rasterizer_.Begin(ShapesRect(shapes).Intersection(image_));
  for (const Shape& shape : shapes) rasterizer_.AddPolygon(shape.points_px, shape.value, shape.alpha);
  rasterizer_.CompositeOnto(sharp_);
}

PixelRect SceneRenderer::Render(const RigidTransform& camera_from_object, double t_s) {
  const double light = LightAt(t_s);
  const double background_light = options_.light.reaches_background ? light : 1.0;
  std::vector<std::vector<Shape>> layers;
  const Vector3d camera_object = camera_from_object.Inverse().translation_m;
  for (const int body : PaintersOrder(object_.bodies, camera_object)) {
    layers.push_back(BodyShapes(object_.bodies[body], camera_from_object, light));
  }
  layers.push_back(OccluderShapes(camera_from_object, t_s));
  const int radius = blur_.radius_px();
  if (IsTextureMoving()) PaintBackground(t_s);
  const PixelRect swept = MoveBackgroundEdge(t_s).Grown(radius).Intersection(image_);
  PixelRect drawn = mesh_ == nullptr ? PixelRect() : mesh_->Render(camera_from_object, light);
  for (const std::vector<Shape>& shapes : layers) drawn = drawn.Union(ShapesRect(shapes));
  drawn = drawn.Grown(radius).Intersection(image_);
  const bool all = background_light != last_background_light_ || IsTextureMoving();
  const PixelRect changed = all ? image_ : drawn.Union(last_rect_).Union(swept);
  last_rect_ = drawn;
  last_background_light_ = background_light;
  if (changed.empty()) return changed;

  const PixelRect source = changed.Grown(radius).Intersection(image_);
  const float factor = static_cast<float>(background_light);
  for (int y = source.y0; y < source.y1; ++y) {
    const size_t row = static_cast<size_t>(y) * image_.x1;
    for (size_t i = row + source.x0; i < row + source.x1; ++i) sharp_[i] = background_[i] * factor;
  }
  if (mesh_ != nullptr) mesh_->CompositeOnto(sharp_);
  for (const std::vector<Shape>& shapes : layers) Composite(shapes);
  blur_.Apply(sharp_, image_.x1, image_.y1, changed, picture_);
  return changed;
}

double SceneRenderer::LargestMotionPx(const RigidTransform& pose_a, double t_a_s, const RigidTransform& pose_b,
                                      double t_b_s) const {
  double largest = 0.0;
  for (const Vector3d& point : object_.extremes) {
    const Vector3d a = pose_a * point;
    const Vector3d b = pose_b * point;
    if (a.z() < kNearM || b.z() < kNearM) continue;
    // The image of a fisheye lens moves by far less than the undistorted one beside the axis.
    const bool is_fisheye = camera_.lens_model == LensModel::kFisheye;
    const Vector2d a_px = camera_.Project(a), b_px = camera_.Project(b);
    largest = std::max(largest, (is_fisheye ? camera_.Distort(a_px) - camera_.Distort(b_px) : a_px - b_px).norm());
  }
  if (options_.occluder.is_present) {
    largest = std::max(largest, std::abs(OccluderX(pose_b, t_b_s) - OccluderX(pose_a, t_a_s)));
  }
  if (!edgeless_.empty()) largest = std::max(largest, std::abs(EdgeX(t_b_s) - EdgeX(t_a_s)));
  return std::max(largest, (TextureShiftPx(t_b_s) - TextureShiftPx(t_a_s)).norm());
}

}  // namespace evpose
