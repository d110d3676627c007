// SPDX-License-Identifier: Apache-2.0

// Recordings of the speed benchmark: simulated at the rates of a quiet scene, of a fast one, and of the full bandwidth
// of a camera.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/events/decoder.h"
#include "core/events/event.h"
#include "core/geometry/rigid_transform.h"
#include "core/geometry/trajectory.h"
#include "core/models/object_model.h"
#include "core/simulation/simulator.h"

namespace evpose {

struct SpeedScene {
  std::string name;
  std::string description;
  SimulationOptions simulation;
};

// Returns the scenes "1", "4", "10", "33" and "50", named by their rates in million events per second. The object is a
// book with 25 lines; about 20 of them are visible.
const std::vector<SpeedScene>& SpeedScenes();

struct SpeedRecording {
  std::string scene;
  SensorGeometry geometry;
  int64_t duration_us = 0;
  std::vector<Event> events;
  std::shared_ptr<const ObjectModel> model;
  CameraModel camera;
  RigidTransform initial_camera_from_object;  // true pose at the beginning
  Trajectory truth;                           // true trajectory, one pose per millisecond

  // Million events per second of sensor time.
  double RateMevPerS() const { return static_cast<double>(events.size()) / static_cast<double>(duration_us); }
};

// Simulates a scene for `duration_us`. `on_progress` is called with the finished share, in [0, 1], and may be null.
// Errors: CANCELLED if it returns false.
absl::StatusOr<SpeedRecording> MakeSpeedRecording(const SpeedScene& scene, int64_t duration_us,
                                                  const std::function<bool(double)>& on_progress = nullptr);
// The same by the name of the scene. Errors: as above, and INVALID_ARGUMENT lists the known names.
absl::StatusOr<SpeedRecording> MakeSpeedRecording(const std::string& scene, int64_t duration_us,
                                                  const std::function<bool(double)>& on_progress = nullptr);

// Returns the bytes of the events. Errors: those of the encoder.
absl::StatusOr<std::vector<uint8_t>> EncodeRecording(const SpeedRecording& recording, Encoding encoding);

}  // namespace evpose
