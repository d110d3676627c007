// SPDX-License-Identifier: Apache-2.0

// Fuzz target for damaged checkpoints. Each is either rejected with an error, or restores a session that continues
// without a fault. The input describes the damage to a valid checkpoint: changed bytes, a truncated end.
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/association/camera_tables.h"
#include "core/base/byte_order.h"
#include "core/baselines/estimators/estimator_factory.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/initialization/search_model.h"
#include "core/models/object_model.h"
#include "core/tracking/object/tracker_options.h"
#include "server/sessions/session_pipeline.h"
#include "server/sessions/session_testing.h"
#include "tests/fuzz/fuzz_input.h"
#include "tests/fuzz/require.h"

namespace evpose {
namespace {

// A small image with proportionally small counts and times, so that a session reaches all of its states within few
// events.
const CameraModel kCamera = testing::MakeCamera(48, 36, 48);
constexpr int64_t kBeforeUs = 24'000;
constexpr int64_t kAfterUs = 1'000;
constexpr double kDensity = 3.0;  // events per square pixel that the lines sweep
constexpr double kNoise = 300.0;  // events per second over the image

TrackerOptions Options(Estimator estimator) {
  TrackerOptions options;
  options.estimator_factory = EstimatorFactoryOf(estimator);
  options.sensor = testing::UnbiasedSensor();
  options.windows.min_events = 10;
  options.windows.max_events = 100;
  options.mixture.max_passes = 2;
  options.health.min_events = 60;
  options.health.min_span_us = 1000;
  options.health.memory_us = 10'000;
  options.health.max_hold_us = 2000;
  options.health.min_contradiction_us = 3000;
  options.health.lost_after_us = 5000;
  options.initialization.memory_us = 10'000;
  options.initialization.max_window_events = 100;
  options.initialization.max_events = 200;
  options.initialization.min_events = 60;
  options.initialization.retry_us = 3000;
  options.initialization.max_retry_us = 6000;
  options.initialization.max_no_pose_retry_us = 10'000;
  options.initialization.repeat_us = 5000;
  return options;
}

absl::StatusOr<std::unique_ptr<Tracker>> MakeTracker(const server::SessionConfig& config,
                                                     const std::vector<std::shared_ptr<const ObjectModel>>& models) {
  static const auto tables = MakeCameraTables(kCamera).value();
  static const auto search_model = MakeSearchModel(models[0]).value();
  std::vector<ObjectToTrack> objects;
  for (const server::ObjectConfig& object : config.objects) {
    objects.push_back({models[0], object.initial_camera_from_object, object.reference_rotation, search_model});
  }
  return Tracker::Create(std::move(objects), config.camera, Options(config.estimator), tables);
}

// An object with half as many lines as a cube.
std::shared_ptr<const ObjectModel> Tetrahedron() {
  static const std::string file =
      "v 0.1 0.1 0.1\nv 0.1 -0.1 -0.1\nv -0.1 0.1 -0.1\nv -0.1 -0.1 0.1\nf 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n";
  static const auto model =
      std::make_shared<const ObjectModel>(ParseObjectModel(AsBytes(file), ModelFormat::kObj, {}).value());
  return model;
}

std::unique_ptr<server::SessionPipeline> MakePipeline(const server::SessionConfig& config) {
  return server::SessionPipeline::Create(config, {config.objects.size(), Tetrahedron()}, MakeTracker).value();
}

RigidTransform PoseAt(double t_s) {
  return testing::MakePose({0.8 * t_s - 0.02, 0.4 * t_s, 0.5}, {0.6 + 4.0 * t_s, 0.5 + 2.0 * t_s, 0.2});
}

std::string EventsOf(double events_per_px2, double clutter_per_s, int64_t t_begin_us, int64_t duration_us) {
  testing::IdealEventOptions options;
  options.events_per_px2 = events_per_px2;
  options.clutter_per_s = clutter_per_s;
  options.t_begin_us = t_begin_us;
  options.duration_us = duration_us;
  return server::Flat64(testing::MakeIdealEvents(*Tetrahedron(), kCamera, PoseAt, options));
}

struct Base {
  server::SessionConfig config;
  server::StreamPosition position;
  server::SavedTracker tracker;
};

server::SessionConfig Config(Estimator estimator, const std::vector<std::string>& objects = {"cube"}) {
  server::SessionConfig config = server::SomeConfig(objects);
  config.estimator = estimator;
  config.camera = kCamera;
  config.sensor = testing::UnbiasedSensor();
  for (server::ObjectConfig& object : config.objects) object.initial_camera_from_object = std::nullopt;
  config.objects[0].initial_camera_from_object = PoseAt(0.0);
  return config;
}

Base MakeBase(const server::SessionConfig& config, const std::string& bytes) {
  const auto pipeline = MakePipeline(config);
  server::PipelineOutput output;
  pipeline->Process(AsBytes(bytes), output);
  server::PipelineState state = pipeline->SaveState();
  return {config, std::move(state.position), std::move(state.tracker)};
}

// Checkpoints at the start, while tracking, while searching after a loss, and with a second object that is not in view.
std::vector<Base> MakeBases() {
  const std::string few = EventsOf(kDensity, kNoise, 0, 1000);
  const std::string enough = EventsOf(kDensity, kNoise, 0, kBeforeUs);
  std::vector<Base> bases;
  for (const Estimator estimator : {Estimator::kMixture, Estimator::kErrorStateFilter}) {
    const server::SessionConfig config = Config(estimator);
    for (const std::string& bytes : {few, enough}) bases.push_back(MakeBase(config, bytes));
  }
  bases.push_back(MakeBase(Config(Estimator::kMixture), EventsOf(0.0, 20'000.0, 0, kBeforeUs)));
  bases.push_back(MakeBase(Config(Estimator::kMixture, {"cube", "another"}), EventsOf(kDensity, kNoise, 0, 8'000)));
  return bases;
}

// The state of the decoder, followed by that of the tracker. Between them is the large history of the pixels; so
// offsets count from either end.
std::string Damage(std::string state, FuzzInput& input) {
  if (input.Choice(4) == 0) state.resize(input.Word() % state.size());
  while (!input.empty() && !state.empty()) {
    const bool from_end = input.Choice(2) == 0;
    const size_t offset = input.Word() % state.size();
    const uint8_t byte = input.Byte();
    state[from_end ? state.size() - 1 - offset : offset] = static_cast<char>(byte);
  }
  return state;
}

}  // namespace
}  // namespace evpose

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose;
  static const std::vector<Base>& bases = *new std::vector<Base>(MakeBases());
  FuzzInput input(data, size);
  const uint8_t choice = input.Byte();
  const Base& base = bases[choice % bases.size()];
  const bool comes_to_its_end = choice / bases.size() % 4 == 0;
  const std::string state = Damage(base.position.decoder + base.tracker.bytes, input);
  server::StreamPosition position = base.position;
  server::SavedTracker tracker = base.tracker;
  position.decoder = state.substr(0, base.position.decoder.size());
  tracker.bytes = state.substr(position.decoder.size());
  const auto pipeline = MakePipeline(base.config);
  absl::Status loaded = pipeline->LoadTracker(tracker);
  if (loaded.ok()) loaded = pipeline->LoadPosition(position);
  EVPOSE_FUZZ_REQUIRE(loaded.ok() || !loaded.message().empty());
  if (!loaded.ok()) return 0;
  static const std::string& after = *new std::string(EventsOf(kDensity, kNoise, kBeforeUs, kAfterUs));
  server::PipelineOutput output;
  pipeline->Process(AsBytes(after), output);
  if (comes_to_its_end) pipeline->Finish(output);
  return 0;
}
