// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/tracking_scenarios.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "core/base/find_named.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

// An object in its standard scene, for five seconds.
TrackingScenario MakeScenario(std::string name, std::string description, std::string_view object, double noise_ratio,
                              std::string_view camera = "evk4") {
  TrackingScenario scenario = {
      std::move(name), std::move(description), SimulationPreset(object, camera).value_or(SimulationOptions()), {}};
  scenario.simulation.duration_us = 5'000'000;
  scenario.simulation.sensor.noise_ratio = noise_ratio;
  return scenario;
}

// A spacecraft in front of the VGA sensor, at the speeds of the paper.
struct VgaScene {
  double duration_s;
  double depth_m;
  double size_m;
  double speed_m_per_s;
  double angular_speed_rad_per_s;
};

TrackingScenario MakeVga(std::string name, std::string description, const VgaScene& scene) {
  TrackingScenario scenario = MakeScenario(std::move(name), std::move(description), "spacecraft", 0.05, "vga");
  SimulationOptions& options = scenario.simulation;
  options.duration_us = static_cast<int64_t>(scene.duration_s * 1e6);
  options.scene.object_size_m = scene.size_m;
  options.scene.motion.depth_m = scene.depth_m;
  options.scene.motion.speed_m_per_s = scene.speed_m_per_s;
  options.scene.motion.angular_speed_rad_per_s = scene.angular_speed_rad_per_s;
  scenario.targets.position_rmse_of_depth = 0.0015;
  scenario.targets.rotation_median_deg = 0.16;
  scenario.targets.rotation_p95_deg = 0.4;
  return scenario;
}

void AddVga(std::vector<TrackingScenario>& scenarios) {
  // A panel's tips are 180 px apart in the first two, 240 px in the others.
  scenarios.push_back(MakeVga("normal", "a spacecraft at 0.71 m/s", {20.0, 1.6, 0.56, 0.71, 0.32}));
  scenarios.push_back(MakeVga("fast", "a spacecraft at 1.41 m/s", {10.0, 1.6, 0.56, 1.41, 0.63}));
  scenarios.push_back(MakeVga("faster", "a larger spacecraft at 2.83 m/s", {5.0, 1.4, 0.65, 2.83, 1.26}));
  const VgaScene light = {10.0, 1.4, 0.63, 0.77, 0.18};
  scenarios.push_back(MakeVga("constant-light", "a spacecraft at 0.77 m/s, steady light", light));
  TrackingScenario& changing = scenarios.emplace_back(
      MakeVga("changing-light", "the same while the light on everything falls to a half and rises, in 2 s", light));
  changing.simulation.scene.light.change_ratio = 2.0;
  changing.simulation.scene.light.change_period_s = 2.0;
  changing.simulation.scene.light.reaches_background = true;
  changing.targets.position_rmse_of_depth *= 2.0;
  changing.targets.rotation_median_deg *= 2.0;
  changing.targets.rotation_p95_deg *= 2.0;
}

// 10 % noise, the flicker of a bulb, and a bar that swings in front of the object.
TrackingScenario MakeHd(const std::string& object) {
  TrackingScenario scenario =
      MakeScenario(object, absl::StrCat(object, ", 10 % noise, flicker, occlusion"), object, 0.1);
  scenario.simulation.scene.light.flicker_depth = 0.15;
  scenario.simulation.scene.occluder.is_present = true;
  return scenario;
}

// Appends the standard scene of a cube with 5 % noise, to which one difficulty is added.
TrackingScenario& AddCube(std::vector<TrackingScenario>& scenarios, std::string name, std::string description) {
  return scenarios.emplace_back(MakeScenario(std::move(name), std::move(description), "cube", 0.05));
}

double NumPixels(const SimulationOptions& options) { return 1.0 * options.camera.width_px * options.camera.height_px; }

void AddNoiseScenarios(std::vector<TrackingScenario>& scenarios) {
  TrackingScenario& activity = AddCube(scenarios, "background-activity", "a cube, 5 Hz of noise per pixel");
  activity.simulation.sensor.shot_noise_hz = 5.5;  // in the dark: 5 on the background
  TrackingScenario& hot = AddCube(scenarios, "hot-pixels", "a cube, 300 hot pixels of about 1 kHz");
  hot.simulation.sensor.hot_pixel_ratio = 300.0 / NumPixels(hot.simulation);
  hot.simulation.sensor.hot_pixel_hz = 1000.0;
}

void AddClutterScenarios(std::vector<TrackingScenario>& scenarios) {
  // The cube's outline is about 290 px wide: 0.2 m, seen from a corner, 1 m away.
  TrackingScenario& occlusion =
      AddCube(scenarios, "occlusion-40", "a cube, 40 % of it behind a bar that moves with it");
  OccluderOptions& bar = occlusion.simulation.scene.occluder;
  bar.is_present = true;
  bar.follows_object = true;
  bar.width_px = 115.0;
  bar.swing_ratio = 0.05;
  bar.speed_px_per_s = 120.0;
  TrackingScenario& bursts = AddCube(scenarios, "bursts", "a cube, every second 50 ms of 20 Mev/s anywhere");
  bursts.simulation.sensor.flood_hz = 20e6;
  TrackingScenario& edge = AddCube(scenarios, "background-edge", "a cube, a bright straight edge sweeping behind it");
  edge.simulation.scene.background.has_moving_edge = true;
}

void AddOneDifficulty(std::vector<TrackingScenario>& scenarios) {
  TrackingScenario& rests = AddCube(scenarios, "rests", "a cube that moves for 0.7 s and stands still for 0.3 s");
  rests.simulation.scene.motion.profile = MotionProfile::kRests;
  AddNoiseScenarios(scenarios);
  AddClutterScenarios(scenarios);
  TrackingScenario& half_out =
      AddCube(scenarios, "half-out", "a cube, half of it out of view at either side of the image");
  half_out.simulation.scene.motion.profile = MotionProfile::kHalfOut;
  // Moves from border to border and back during the recording.
  half_out.simulation.scene.motion.speed_m_per_s = 0.6;
  TrackingScenario& uncalibrated =
      AddCube(scenarios, "uncalibrated", "a cube, another sensor's thresholds, bandwidth and lens");
  uncalibrated.simulation.sensor.threshold_on = 0.20;
  uncalibrated.simulation.sensor.threshold_off = 0.36;
  uncalibrated.simulation.sensor.threshold_mismatch_ratio = 0.06;
  uncalibrated.simulation.sensor.bandwidth_hz = 1000.0;
  uncalibrated.simulation.scene.lens_blur_px = 0.8;
  uncalibrated.targets.position_rmse_of_depth *= 3.0;
}

}  // namespace

std::vector<TrackingScenario> TrackingScenarios() {
  std::vector<TrackingScenario> scenarios;
  AddVga(scenarios);
  for (const char* object : {"planar", "cube", "book", "spacecraft"}) scenarios.push_back(MakeHd(object));
  AddOneDifficulty(scenarios);
  return scenarios;
}

absl::StatusOr<std::vector<TrackingScenario>> FindTrackingScenarios(const std::vector<std::string>& names) {
  std::vector<TrackingScenario> all = TrackingScenarios();
  if (names.empty()) return all;
  EVPOSE_RETURN_IF_ERROR(FindAllNamed(all, names, "no scenario is called \"$0\"").status());
  std::erase_if(all, [&](const TrackingScenario& scenario) {
    return std::find(names.begin(), names.end(), scenario.name) == names.end();
  });
  return all;
}

SimulationOptions TrackingRun(const TrackingScenario& scenario, uint64_t seed, uint64_t path, int64_t max_duration_us) {
  SimulationOptions options = scenario.simulation;
  options.seed = seed;
  options.path_seed = path;
  if (max_duration_us > 0) options.duration_us = std::min(options.duration_us, max_duration_us);
  return options;
}

}  // namespace evpose
