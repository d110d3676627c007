// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/speed/speed_recordings.h"

#include <optional>
#include <utility>

#include "core/base/find_named.h"
#include "core/base/status_macros.h"
#include "core/events/encoder.h"

namespace evpose {
namespace {

// A book with a factor on its speed, the depth of flicker of its lamp, and the thresholds and refractory time of the
// sensor; nullopt: the default.
SpeedScene MakeScene(const char* name, const char* description, double speed, double flicker_depth = 0.0,
                     std::optional<double> threshold = {}, std::optional<double> refractory_us = {}) {
  SpeedScene scene = {name, description, SimulationPreset("book", "evk4", speed).value()};
  // The clock does not wrap, because wraps are rare in a stream.
  scene.simulation.t_begin_us = 1'000'000;
  scene.simulation.scene.light.flicker_depth = flicker_depth;
  SensorOptions& sensor = scene.simulation.sensor;
  if (threshold) sensor.threshold_on = sensor.threshold_off = *threshold;
  if (refractory_us) sensor.refractory_us = *refractory_us;
  return scene;
}

}  // namespace

const std::vector<SpeedScene>& SpeedScenes() {
  static const std::vector<SpeedScene>* const scenes = new std::vector<SpeedScene>{
      MakeScene("1", "a book at 0.13 m/s", 0.6),
      MakeScene("4", "at 0.66 m/s", 3.0),
      MakeScene("10", "at 0.88 m/s, thresholds of 0.16, refractory time of 30 us", 4.0, 0.0, 0.16, 30.0),
      MakeScene("33", "at 0.44 m/s under a lamp that flickers by 0.56", 2.0, 0.56),
      MakeScene("50", "the same, flicker of 0.5, thresholds of 0.16", 2.0, 0.5, 0.16),
  };
  return *scenes;
}

absl::StatusOr<SpeedRecording> MakeSpeedRecording(const SpeedScene& scene, int64_t duration_us,
                                                  const std::function<bool(double)>& on_progress) {
  SimulationOptions options = scene.simulation;
  options.duration_us = duration_us;
  SpeedRecording recording;
  recording.scene = scene.name;
  recording.duration_us = duration_us;
  recording.camera = options.camera;
  recording.geometry = {options.camera.width_px, options.camera.height_px};
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, SimulatedModel(options));
  recording.model = std::make_shared<const ObjectModel>(std::move(model));
  recording.truth = SimulatedTruth(options);
  if (!recording.truth.empty()) recording.initial_camera_from_object = recording.truth.front().camera_from_object;
  const auto on_events = [&](absl::Span<const Event> events) {
    recording.events.insert(recording.events.end(), events.begin(), events.end());
    const int64_t done_us = events.empty() ? 0 : events.back().t_us - options.t_begin_us;
    const double done_ratio = static_cast<double>(done_us) / static_cast<double>(duration_us);
    if (on_progress && !on_progress(done_ratio)) return absl::CancelledError("interrupted");
    return absl::OkStatus();
  };
  EVPOSE_RETURN_IF_ERROR(Simulate(options, on_events).status());
  return recording;
}

absl::StatusOr<SpeedRecording> MakeSpeedRecording(const std::string& scene, int64_t duration_us,
                                                  const std::function<bool(double)>& on_progress) {
  EVPOSE_ASSIGN_OR_RETURN(const SpeedScene found, FindNamed(SpeedScenes(), scene, "no scene is called \"$0\""));
  return MakeSpeedRecording(found, duration_us, on_progress);
}

absl::StatusOr<std::vector<uint8_t>> EncodeRecording(const SpeedRecording& recording, Encoding encoding) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<EventEncoder> encoder, MakeEventEncoder(encoding, recording.geometry));
  std::vector<uint8_t> bytes;
  EVPOSE_RETURN_IF_ERROR(encoder->Encode(recording.events, bytes));
  return bytes;
}

}  // namespace evpose
