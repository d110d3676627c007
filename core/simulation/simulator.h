// SPDX-License-Identifier: Apache-2.0

// An event camera looking at a moving object: the project's own truth.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/events/event.h"
#include "core/geometry/camera.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/simulation/scene.h"
#include "core/simulation/sensor.h"

namespace evpose {

struct SimulationOptions {
  SceneOptions scene;    // object, texture, motion, background, lights, occluder: scene.h
  SensorOptions sensor;  // thresholds, bandwidth, refractory time, leak, noise, hot pixels: sensor.h
  CameraModel camera = SimulatedEvk4Camera();
  // On the sensor's clock, below 2^24 (16.8 s): what a decoder takes an EVT3 recording to begin at. By default the
  // clock wraps 0.78 s after the beginning, so that the wrap is in every recording of a second.
  int64_t t_begin_us = 16'000'000;
  int64_t duration_us = 5'000'000;  // at most half an hour
  double max_step_px = 0.4;         // the image moves by at most this between two renderings
  uint64_t seed = 1;                // of the motion, the texture, the pixels and the noise
  // Of the motion alone: the same path before other pixels, noise and textures. Without it: `seed`.
  std::optional<uint64_t> path_seed;

  // The EVK4 (1280x720 pixels of 4.86 um) behind a 5 mm lens with a little barrel distortion; and a VGA sensor with
  // the same field of view.
  static CameraModel SimulatedEvk4Camera();
  static CameraModel SimulatedVgaCamera();

  // INVALID_ARGUMENT naming the field that is wrong.
  absl::Status Validate() const;
};

// The standard scene of an object: its size, depth and motion such that an EVK4 sends about 1e6 events/s.
// `speed_scale` multiplies the speeds. Errors: INVALID_ARGUMENT listing the known names ("cube", ...; "evk4", "vga").
absl::StatusOr<SimulationOptions> SimulationPreset(std::string_view object_name, std::string_view camera_name = "evk4",
                                                   double speed_scale = 1.0);
std::vector<std::string> SimulatedCameraNames();

struct SimulationReport {
  uint64_t events = 0;
  uint64_t noise_events = 0;  // of them, from leak, shot noise, hot pixels, SensorOptions.noise_ratio and floods
  int64_t rendered_frames = 0;
  double max_speed_px_per_s = 0.0;
};

// Runs the simulation; events arrive in order of time, in batches. An error of `on_events` ends it and is returned.
absl::StatusOr<SimulationReport> Simulate(const SimulationOptions& options,
                                          const std::function<absl::Status(absl::Span<const Event>)>& on_events,
                                          const std::function<void(double progress_ratio)>& on_progress = nullptr);

// camera_from_object every millisecond from the beginning to the end, both included. Empty for invalid options.
Trajectory SimulatedTruth(const SimulationOptions& options);
absl::StatusOr<ObjectModel> SimulatedModel(const SimulationOptions& options);

// Writes recording.raw (EVT3 as an EVK4 writes it), truth.tum, model.obj and camera.yaml into `directory`, which is
// made when it is missing. Whole or not at all: on an error no file of that name is new or changed. Errors also name
// the path that cannot be written; CANCELLED when `is_cancelled` says so, which is asked now and then.
absl::StatusOr<SimulationReport> SimulateToDirectory(
    const SimulationOptions& options, const std::string& directory,
    const std::function<void(double progress_ratio)>& on_progress = nullptr,
    const std::function<bool()>& is_cancelled = nullptr);

}  // namespace evpose
