// SPDX-License-Identifier: Apache-2.0

// Simulates an event camera in front of a moving object (core/simulation/README.md).
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
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

// max_step_px is validated by simulator_test: with steps of 0.1 px the places of the events change by less than 0.02 px
// and their number by less than 2 %. The other fields are input.
struct SimulationOptions {
  SceneOptions scene;    // object, texture, motion, background, lights, occluder: scene.h
  SensorOptions sensor;  // thresholds, bandwidth, refractory time, leak, noise, hot pixels: sensor.h
  CameraModel camera = SimulatedEvk4Camera();
  // Start on the sensor's clock. It is below 2^24 us (16.8 s), because a decoder assumes such a start for an EVT3
  // recording. By default, the clock wraps 0.78 s after the start, so that every recording of a second contains a wrap.
  int64_t t_begin_us = 16'000'000;
  int64_t duration_us = 5'000'000;  // at most half an hour
  double max_step_px = 0.4;         // largest motion of the image between two renderings
  uint64_t seed = 1;                // seed of the motion, the texture, the pixels and the noise
  // Seed of the motion alone, and of the mean attitude of SceneOptions::model, to combine one path with different
  // pixels, noise and textures. Default: `seed`.
  std::optional<uint64_t> path_seed;

  // The EVK4 (1280x720 pixels of 4.86 um) behind a 5 mm lens with slight barrel distortion, and a VGA sensor with the
  // same field of view.
  static CameraModel SimulatedEvk4Camera();
  static CameraModel SimulatedVgaCamera();

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// The standard scene of an object; size, depth and motion are such that an EVK4 emits about 1e6 events/s. `speed_scale`
// multiplies the speeds. Errors: INVALID_ARGUMENT listing the known names ("cube", ...; "evk4", "vga").
absl::StatusOr<SimulationOptions> SimulationPreset(std::string_view object_name, std::string_view camera_name = "evk4",
                                                   double speed_scale = 1.0);
// The same for a model with faces, which has a diameter of about 300 px in the image of an EVK4, moves by about 320
// px/s, and has light and shade. Errors: INVALID_ARGUMENT for a model without faces, or listing the cameras.
absl::StatusOr<SimulationOptions> ModelSimulationPreset(std::shared_ptr<const ObjectModel> model,
                                                        std::string_view camera_name = "evk4",
                                                        double speed_scale = 1.0);
std::vector<std::string> SimulatedCameraNames();
// Replaces the camera of a standard scene. Behind a longer lens than that of the EVK4, relative to the image's width,
// the object is farther away by the same factor, so that it has the same share of the image, and moves as fast in it.
void UseCamera(const CameraModel& camera, SimulationOptions& options);

struct SimulationReport : SensorCounts {
  int64_t rendered_frames = 0;      // number of rendered pictures
  double max_speed_px_per_s = 0.0;  // largest image speed of the object, the occluder or the moving edge
};

// Runs the simulation; events are delivered in order of time, in batches. An error of `on_events` ends the simulation
// and is returned.
absl::StatusOr<SimulationReport> Simulate(const SimulationOptions& options,
                                          const std::function<absl::Status(absl::Span<const Event>)>& on_events,
                                          const std::function<void(double progress_ratio)>& on_progress = nullptr);

// Returns camera_from_object for every millisecond from the start to the end, both included. Empty for invalid options.
Trajectory SimulatedTruth(const SimulationOptions& options);
// Returns the model of the simulated object. Error: that of SimulationOptions::Validate().
absl::StatusOr<ObjectModel> SimulatedModel(const SimulationOptions& options);

// The files of SimulateToDirectory(). The first one, which has the options as text, tells a directory of a simulation
// from others; it is written first.
inline constexpr const char* kSimulationNote = "simulation.txt";
inline constexpr std::array<const char*, 5> kSimulationFiles = {kSimulationNote, "recording.raw", "truth.tum",
                                                                "model.obj", "camera.yaml"};

// Writes kSimulationFiles, the recording in EVT3 as an EVK4 writes it, into `directory`, which is created if it does
// not exist. Of SceneOptions::model, model.obj has the mesh in metres and the painted lines. On an error of
// the simulation, no file of that name is new or changed; the finished files replace earlier ones one after another,
// and an error at that may leave files of two simulations. Two simulations at a time must not have the same directory,
// in which both write `.simulation-in-progress`. Errors name the path that cannot be written; CANCELLED if
// `is_cancelled`, which is called from time to time, returns true.
absl::StatusOr<SimulationReport> SimulateToDirectory(
    const SimulationOptions& options, const std::string& directory,
    const std::function<void(double progress_ratio)>& on_progress = nullptr,
    const std::function<bool()>& is_cancelled = nullptr);

}  // namespace evpose
