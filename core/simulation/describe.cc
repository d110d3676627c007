// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/describe.h"

#include <array>
#include <concepts>
#include <cstdint>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/numerics/hash.h"

namespace evpose {
namespace {

// The structures are decomposed by structured bindings, so that a new field without a description does not compile.
class Description {
 public:
  void Add(const char* name, double value) { absl::StrAppendFormat(&text_, "%s %.17g\n", name, value); }
  // Also for a bool: 0 or 1.
  void Add(const char* name, std::integral auto value) { absl::StrAppendFormat(&text_, "%s %d\n", name, value); }
  void Add(const char* name, const std::string& value) { absl::StrAppend(&text_, name, " ", value, "\n"); }
  std::string Take() { return std::move(text_); }

 private:
  std::string text_;
};

void AddMotion(const MotionOptions& options, Description& out) {
  const auto& [depth_m, depth_swing, extent, rotation_swing, speed, angular_speed, profile, view_angle] = options;
  out.Add("scene.motion.depth_m", depth_m);
  out.Add("scene.motion.depth_swing_ratio", depth_swing);
  out.Add("scene.motion.extent_ratio", extent);
  out.Add("scene.motion.rotation_swing_rad", rotation_swing);
  out.Add("scene.motion.speed_m_per_s", speed);
  out.Add("scene.motion.angular_speed_rad_per_s", angular_speed);
  out.Add("scene.motion.profile", static_cast<int64_t>(profile));
  if (view_angle != 0.0) out.Add("scene.motion.view_angle_rad", view_angle);
}

void AddBackground(const BackgroundOptions& options, Description& out) {
  const auto& [reflectance, is_textured, contrast, num_rectangles, texture_speed, has_edge, edge_reflectance,
               edge_speed, edge_tilt] = options;
  out.Add("scene.background.reflectance", reflectance);
  out.Add("scene.background.is_textured", is_textured);
  out.Add("scene.background.texture_contrast", contrast);
  // A background with the default number of rectangles, at rest, keeps the description that it had before the options.
  if (num_rectangles != BackgroundOptions().texture_rectangles) {
    out.Add("scene.background.texture_rectangles", static_cast<int64_t>(num_rectangles));
  }
  if (texture_speed != 0.0) out.Add("scene.background.texture_speed_px_per_s", texture_speed);
  out.Add("scene.background.has_moving_edge", has_edge);
  out.Add("scene.background.edge_reflectance", edge_reflectance);
  out.Add("scene.background.edge_speed_px_per_s", edge_speed);
  out.Add("scene.background.edge_tilt_ratio", edge_tilt);
}

void AddLight(const LightOptions& options, Description& out) {
  const auto& [flicker_depth, flicker_hz, change_ratio, change_period_s, diffuse_ratio, reaches_background] = options;
  out.Add("scene.light.flicker_depth", flicker_depth);
  out.Add("scene.light.flicker_hz", flicker_hz);
  out.Add("scene.light.change_ratio", change_ratio);
  out.Add("scene.light.change_period_s", change_period_s);
  out.Add("scene.light.diffuse_ratio", diffuse_ratio);
  out.Add("scene.light.reaches_background", reaches_background);
}

void AddOccluder(const OccluderOptions& options, Description& out) {
  const auto& [is_present, follows_object, swing_ratio, width_px, speed, reflectance, tilt_ratio] = options;
  out.Add("scene.occluder.is_present", is_present);
  out.Add("scene.occluder.follows_object", follows_object);
  out.Add("scene.occluder.swing_ratio", swing_ratio);
  out.Add("scene.occluder.width_px", width_px);
  out.Add("scene.occluder.speed_px_per_s", speed);
  out.Add("scene.occluder.reflectance", reflectance);
  out.Add("scene.occluder.tilt_ratio", tilt_ratio);
}

void AddModel(const ObjectModel& model, const MeshFinish& finish, Description& out) {
  const auto& [reflectance, specular_ratio] = finish;
  Sha256 digest;
  const auto add = [&digest](const auto& elements) {
    if (elements.empty()) return;
    digest.Update({reinterpret_cast<const uint8_t*>(elements.data()), elements.size() * sizeof(elements[0])});
  };
  add(model.vertices);
  add(model.triangles);
  add(model.surface.normals);
  add(model.surface.region_of);
  // Painted lines are rendered. A model without any keeps the description that it had before they were.
  for (const ModelLine& line : model.lines) {
    if (line.kind == EdgeKind::kPainted) add(std::array{line.p1, line.p2});
  }
  for (const EdgeCurve& curve : model.curves) {
    if (curve.kind == EdgeKind::kPainted) add(curve.points);
  }
  out.Add("scene.model", digest.FinishHex());
  out.Add("scene.finish.reflectance", reflectance);
  out.Add("scene.finish.specular_ratio", specular_ratio);
}

void AddScene(const SceneOptions& options, Description& out) {
  const auto& [object, size_m, motion, background, light, occluder, lens_blur_px, model, finish, shows_front] = options;
  out.Add("scene.object", static_cast<int64_t>(object));
  out.Add("scene.object_size_m", size_m);
  if (model != nullptr) AddModel(*model, finish, out);
  // A scene without it keeps the description that it had before the option.
  if (shows_front) out.Add("scene.shows_front", shows_front);
  AddMotion(motion, out);
  AddBackground(background, out);
  AddLight(light, out);
  AddOccluder(occluder, out);
  out.Add("scene.lens_blur_px", lens_blur_px);
}

void AddSensor(const SensorOptions& options, Description& out) {
  const auto& [threshold_on, threshold_off, mismatch, dark_light, bandwidth_hz, dark_bandwidth, refractory_us, leak_hz,
               shot_noise_hz, hot_pixel_ratio, hot_pixel_hz, noise_ratio, flood_hz, flood_s, flood_period_s] = options;
  out.Add("sensor.threshold_on", threshold_on);
  out.Add("sensor.threshold_off", threshold_off);
  out.Add("sensor.threshold_mismatch_ratio", mismatch);
  out.Add("sensor.dark_light", dark_light);
  out.Add("sensor.bandwidth_hz", bandwidth_hz);
  out.Add("sensor.dark_bandwidth_ratio", dark_bandwidth);
  out.Add("sensor.refractory_us", refractory_us);
  out.Add("sensor.leak_hz", leak_hz);
  out.Add("sensor.shot_noise_hz", shot_noise_hz);
  out.Add("sensor.hot_pixel_ratio", hot_pixel_ratio);
  out.Add("sensor.hot_pixel_hz", hot_pixel_hz);
  out.Add("sensor.noise_ratio", noise_ratio);
  out.Add("sensor.flood_hz", flood_hz);
  out.Add("sensor.flood_s", flood_s);
  out.Add("sensor.flood_period_s", flood_period_s);
}

void AddCamera(const CameraModel& camera, Description& out) {
  const auto& [width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion, lens_model] = camera;
  out.Add("camera.width_px", width_px);
  out.Add("camera.height_px", height_px);
  out.Add("camera.fx_px", fx_px);
  out.Add("camera.fy_px", fy_px);
  out.Add("camera.cx_px", cx_px);
  out.Add("camera.cy_px", cy_px);
  for (const double k : camera.Coefficients()) out.Add("camera.distortion", k);
  if (lens_model != LensModel::kBrown) out.Add("camera.lens_model", static_cast<int64_t>(lens_model));
}

}  // namespace

std::string DescribeSimulation(const SimulationOptions& options) {
  const auto& [scene, sensor, camera, t_begin_us, duration_us, max_step_px, seed, path_seed] = options;
  Description out;
  AddScene(scene, out);
  AddSensor(sensor, out);
  AddCamera(camera, out);
  out.Add("t_begin_us", t_begin_us);
  out.Add("duration_us", duration_us);
  out.Add("max_step_px", max_step_px);
  out.Add("seed", seed);
  out.Add("path_seed", path_seed.value_or(seed));
  return out.Take();
}

}  // namespace evpose
