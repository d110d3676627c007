// Damaged checkpoints: each is refused in words, or makes a session that goes on without a fault. An input is what is
// done to a true one: bytes changed, its end cut off.
#include <iterator>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/models/object_model.h"
#include "server/sessions/session_pipeline.h"
#include "server/sessions/testing.h"
#include "server/sessions/tracker_factory.h"
#include "tests/fuzz/fuzz_input.h"
#include "tests/fuzz/require.h"

namespace evpose {
namespace {

server::SessionConfig Config(Encoding encoding, Estimator estimator) {
  server::SessionConfig config = server::SomeConfig();
  config.encoding = encoding;
  config.estimator = estimator;
  config.camera = {.width_px = 64, .height_px = 48, .fx_px = 60, .fy_px = 60, .cx_px = 32, .cy_px = 24};
  config.objects[0].initial_camera_from_object->translation_m.z() = 0.5;
  return config;
}

std::unique_ptr<server::SessionPipeline> MakePipeline(const server::SessionConfig& config) {
  static const auto model = std::make_shared<const ObjectModel>(
      ParseObjectModel({reinterpret_cast<const uint8_t*>(server::kCubeObj), sizeof(server::kCubeObj) - 1},
                       ModelFormat::kObj, {})
          .value());
  static const server::TrackerFactory make_tracker = server::MakeTrackerFactory();
  return server::SessionPipeline::Create(config, {model}, make_tracker).value();
}

// Events all over the small sensor, `num_ms` of them from `begin_ms` on.
std::string SomeBytes(int64_t begin_ms, int64_t num_ms) {
  std::vector<Event> events;
  for (Event event : server::SomeEvents(begin_ms, begin_ms + num_ms, 40)) {
    event.x %= 64;
    event.y %= 48;
    events.push_back(event);
  }
  return server::Flat64(events);
}

absl::Span<const uint8_t> AsBytes(const std::string& text) {
  return {reinterpret_cast<const uint8_t*>(text.data()), text.size()};
}

struct Base {
  server::SessionConfig config;
  std::unique_ptr<server::SessionPipeline> pipeline;  // keeps what all trackers of the model share
  std::string state;
};

std::vector<Base> MakeBases() {
  std::vector<Base> bases;
  for (const Estimator estimator : {Estimator::kMixture, Estimator::kErrorStateFilter}) {
    for (const int64_t num_ms : {1, 30}) {
      const server::SessionConfig config = Config(Encoding::kFlat64, estimator);
      auto pipeline = MakePipeline(config);
      server::PipelineOutput output;
      pipeline->Process(AsBytes(SomeBytes(0, num_ms)), output);
      const std::string state = pipeline->SaveState();
      bases.push_back({config, std::move(pipeline), state});
    }
  }
  return bases;
}

// Bytes of the pixels' history apart, a state's faults are in its first and last bytes: offsets count from either end.
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
  const Base& base = bases[static_cast<size_t>(input.Choice(static_cast<int>(bases.size())))];
  const std::string state = Damage(base.state, input);
  const auto pipeline = MakePipeline(base.config);
  const absl::Status loaded = pipeline->LoadState(state);
  EVPOSE_FUZZ_REQUIRE(loaded.ok() || !loaded.message().empty());
  if (!loaded.ok()) return 0;
  server::PipelineOutput output;
  pipeline->Process(AsBytes(SomeBytes(30, 3)), output);
  pipeline->Finish(output);
  return 0;
}
