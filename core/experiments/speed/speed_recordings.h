// SPDX-License-Identifier: Apache-2.0

// What the speed is measured on: recordings of the project's simulator at the rates of a quiet scene, of a fast one,
// and of all that a camera's interface carries.
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

// "1", "4", "10", "33" and "50": their rates, in million events per second. A book, of whose 25 lines some 20 are seen.
const std::vector<SpeedScene>& SpeedScenes();

struct SpeedRecording {
  std::string scene;
  SensorGeometry geometry;
  int64_t duration_us = 0;
  std::vector<Event> events;
  std::shared_ptr<const ObjectModel> model;
  CameraModel camera;
  RigidTransform initial_camera_from_object;  // the truth at the beginning
  Trajectory truth;                           // every millisecond

  // Million events per second of sensor time.
  double RateMevPerS() const { return static_cast<double>(events.size()) / static_cast<double>(duration_us); }
};

// Errors: CANCELLED when `on_progress`, told how much is done, [0, 1], returns false. It may be null.
absl::StatusOr<SpeedRecording> MakeSpeedRecording(const SpeedScene& scene, int64_t duration_us,
                                                  const std::function<bool(double)>& on_progress = nullptr);
// By the scene's name. Errors: INVALID_ARGUMENT listing the known ones; as above.
absl::StatusOr<SpeedRecording> MakeSpeedRecording(const std::string& scene, int64_t duration_us,
                                                  const std::function<bool(double)>& on_progress = nullptr);

// Errors: those of the encoder.
absl::StatusOr<std::vector<uint8_t>> EncodeRecording(const SpeedRecording& recording, Encoding encoding);

}  // namespace evpose
