// An event camera looking at a moving object: the project's own truth.
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/geometry/trajectory.h"
#include "core/events/event.h"
#include "core/geometry/camera.h"
#include "core/models/object_model.h"
#include "core/simulation/scene.h"
#include "core/simulation/sensor.h"

namespace evpose {

struct SimulationOptions {
  SceneOptions scene;    // object, texture, motion, background, lights, occluder: scene.h
  SensorOptions sensor;  // thresholds, bandwidth, refractory time, leak, noise, hot pixels: sensor.h
  CameraModel camera;    // an EVK4 (1280x720) with its lens by default
  int64_t t_begin_us = 0;         // on the sensor's clock: a start near 2^24 makes EVT3's clock wrap
  int64_t duration_us = 5'000'000;
  double max_step_px = 0.4;       // the image moves by at most this between two renderings
  uint64_t seed = 1;

  absl::Status Validate() const;
};

struct SimulationReport {
  uint64_t events = 0;
  uint64_t noise_events = 0;  // of them, from leak, shot noise and hot pixels
  int64_t rendered_frames = 0;
  double max_speed_px_per_s = 0.0;
};

// Runs the simulation; events arrive in order of time, in batches. The truth is sampled every millisecond.
absl::StatusOr<SimulationReport> Simulate(const SimulationOptions& options,
                                          const std::function<absl::Status(absl::Span<const Event>)>& on_events,
                                          const std::function<void(double progress_ratio)>& on_progress = nullptr);
Trajectory SimulatedTruth(const SimulationOptions& options);
absl::StatusOr<ObjectModel> SimulatedModel(const SimulationOptions& options);

// Writes recording.raw (EVT3 as an EVK4 writes it), truth.tum, model.obj and camera.yaml into `directory`, which is
// made when it is missing. Whole or not at all.
absl::StatusOr<SimulationReport> SimulateToDirectory(const SimulationOptions& options, const std::string& directory,
                                                     const std::function<void(double progress_ratio)>& on_progress = nullptr);

}  // namespace evpose
