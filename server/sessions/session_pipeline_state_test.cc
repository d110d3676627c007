// SPDX-License-Identifier: Apache-2.0

// A pipeline that is saved and loaded between any two chunks has the same output, to the bit, as one that is not.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <iostream>

#include "core/base/state_io.h"
#include "core/base/status_macros.h"
#include "core/baselines/estimators/estimator_factory.h"
#include "core/events/encoder.h"
#include "core/models/symmetry.h"
#include "core/numerics/random.h"
#include "core/simulation/simulator.h"
#include "core/tracking/object/tracker_options.h"
#include "server/sessions/session_pipeline.h"
#include "server/sessions/session_testing.h"

namespace evpose::server {
namespace {

using testing::HasSubstr;

absl::StatusOr<std::unique_ptr<Tracker>> MakeTracker(const SessionConfig& config,
                                                     const std::vector<std::shared_ptr<const ObjectModel>>& models) {
  std::vector<ObjectToTrack> objects;
  for (size_t i = 0; i < models.size(); ++i) {
    objects.push_back({models[i], config.objects[i].initial_camera_from_object, config.objects[i].reference_rotation});
  }
  TrackerOptions options;
  options.estimator_factory = EstimatorFactoryOf(config.estimator);
  options.sensor = config.sensor;
  return Tracker::Create(objects, config.camera, options);
}

struct Recording {
  SessionConfig config;
  std::vector<std::shared_ptr<const ObjectModel>> models;
  std::vector<Event> events;
  RigidTransform first_pose;
};

Recording Simulated(const char* camera, int64_t duration_us) {
  SimulationOptions options = *SimulationPreset("cube", camera);
  options.duration_us = duration_us;
  options.sensor.noise_ratio = 0.1;
  Recording recording;
  auto model = std::make_shared<ObjectModel>(*SimulatedModel(options));
  model->symmetries = FindSymmetries(*model);
  recording.models = {model};
  recording.config.camera = options.camera;
  recording.config.objects = {{"cube", "models/cube", std::nullopt}};
  recording.first_pose = SimulatedTruth(options).front().camera_from_object;
  const auto report = Simulate(options, [&](absl::Span<const Event> events) {
    recording.events.insert(recording.events.end(), events.begin(), events.end());
    return absl::OkStatus();
  });
  EXPECT_TRUE(report.ok());
  return recording;
}

std::vector<uint8_t> Encoded(const Recording& recording, Encoding encoding) {
  std::vector<uint8_t> bytes;
  if (encoding == Encoding::kDat) {
    for (const Event& event : recording.events) {
      const uint64_t word = static_cast<uint32_t>(event.t_us) | static_cast<uint64_t>(event.x) << 32 |
                            static_cast<uint64_t>(event.y) << 46 | static_cast<uint64_t>(event.polarity) << 60;
      for (int shift = 0; shift < 64; shift += 8) bytes.push_back(static_cast<uint8_t>(word >> shift));
    }
    return bytes;
  }
  const auto encoder =
      MakeEventEncoder(encoding, {recording.config.camera.width_px, recording.config.camera.height_px}).value();
  EXPECT_TRUE(encoder->Encode(recording.events, bytes).ok());
  EXPECT_TRUE(encoder->EncodeTime(recording.events.back().t_us + 30'000, bytes).ok());
  return bytes;
}

std::unique_ptr<SessionPipeline> MakePipeline(const Recording& recording) {
  return SessionPipeline::Create(recording.config, recording.models, MakeTracker).value();
}

absl::Status Load(const PipelineState& state, SessionPipeline& pipeline) {
  EVPOSE_RETURN_IF_ERROR(pipeline.LoadTracker(state.tracker));
  return pipeline.LoadPosition(state.position);
}

// Returns all bytes of the output, and clears it.
std::string TakeBytes(PipelineOutput& output) {
  StateWriter writer;
  writer(output.poses);
  for (const ObjectStateChange& change : output.state_changes) {
    writer(change.object_index, change.t_us, static_cast<int>(change.state), change.num_poses_before);
  }
  output.clear();
  return writer.Take();
}

// Feeds two pipelines with chunks of random sizes. One pipeline is saved and loaded between all chunks. In some places
// bytes are lost or a pose is given. Returns some of the states.
std::vector<PipelineState> ExpectSameWhenMoved(const Recording& recording, absl::Span<const uint8_t> bytes,
                                               size_t max_chunk, uint64_t seed) {
  Random random(seed);
  const auto whole = MakePipeline(recording);
  auto moved = MakePipeline(recording);
  std::vector<PipelineState> states;
  PipelineOutput output, moved_output;
  for (size_t begin = 0; begin < bytes.size();) {
    const auto chunk = bytes.subspan(begin, 1 + random.UniformInt(max_chunk));
    for (SessionPipeline* pipeline : {whole.get(), moved.get()}) {
      pipeline->Process(chunk, pipeline == whole.get() ? output : moved_output);
    }
    begin += chunk.size();
    if (random.UniformInt(30) == 0) {
      whole->ResetAfterLoss();
      moved->ResetAfterLoss();
    }
    if (random.UniformInt(60) == 0) {
      whole->ResetPose(0, recording.first_pose);
      moved->ResetPose(0, recording.first_pose);
    }
    const PipelineState state = moved->SaveState();
    EXPECT_TRUE(state == whole->SaveState()) << "at byte " << begin;
    moved = MakePipeline(recording);
    EXPECT_EQ(Load(state, *moved), absl::OkStatus()) << "at byte " << begin;
    EXPECT_TRUE(moved->SaveState() == state) << "at byte " << begin;
    EXPECT_TRUE(TakeBytes(output) == TakeBytes(moved_output)) << "at byte " << begin;
    EXPECT_EQ(moved->counts(), whole->counts());
    EXPECT_EQ(moved->now_us(), whole->now_us());
    EXPECT_EQ(moved->first_t_us(), whole->first_t_us());
    if (::testing::Test::HasFailure()) return states;
    if (random.UniformInt(5) == 0) states.push_back(state);
  }
  whole->Finish(output);
  moved->Finish(moved_output);
  EXPECT_TRUE(TakeBytes(output) == TakeBytes(moved_output));
  EXPECT_EQ(moved->tracker().losses(), whole->tracker().losses());
  return states;
}

const Recording& Vga() {
  static const Recording recording = Simulated("vga", 60'000);
  return recording;
}

TEST(SessionPipelineStateTest, EveryEncodingGoesOnWhereItWas) {
  for (const Encoding encoding :
       {Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kDat, Encoding::kFlat64}) {
    SCOPED_TRACE(std::string(EncodingName(encoding)));
    Recording recording = Vga();
    recording.config.encoding = encoding;
    const std::vector<uint8_t> bytes = Encoded(recording, encoding);
    ExpectSameWhenMoved(recording, bytes, bytes.size() / 8, 1 + static_cast<uint64_t>(encoding));
  }
}

TEST(SessionPipelineStateTest, DamagedStatesAreRefusedOrGoOn) {
  const Recording& recording = Vga();
  const std::vector<uint8_t> bytes = Encoded(recording, recording.config.encoding);
  const std::vector<PipelineState> states = ExpectSameWhenMoved(recording, bytes, bytes.size() / 8, 9);
  ASSERT_FALSE(states.empty());
  PipelineState cut = states.back();
  for (std::string* part : {&cut.tracker.bytes, &cut.position.decoder}) {
    const std::string whole = *part;
    for (size_t size = 0; size < whole.size(); size += 1 + whole.size() / 10) {
      *part = whole.substr(0, size);
      EXPECT_EQ(Load(cut, *MakePipeline(recording)).code(), absl::StatusCode::kDataLoss) << size;
    }
    *part = whole;
  }
  Random random(10);
  for (int i = 0; i < 40; ++i) {
    PipelineState damaged = states[random.UniformInt(states.size())];
    std::string& bytes_of_it = i % 8 == 0 ? damaged.position.decoder : damaged.tracker.bytes;
    bytes_of_it[random.UniformInt(bytes_of_it.size())] ^= static_cast<char>(1 << random.UniformInt(8));
    const auto pipeline = MakePipeline(recording);
    if (!Load(damaged, *pipeline).ok()) continue;
    PipelineOutput output;
    const auto rest = absl::MakeConstSpan(bytes).subspan(random.UniformInt(bytes.size()), 20'000);
    pipeline->Process(rest, output);
    pipeline->Finish(output);
  }
}

TEST(SessionPipelineStateTest, AStateOfAnotherConfigurationIsRefused) {
  const Recording& recording = Vga();
  const PipelineState state = MakePipeline(recording)->SaveState();
  const auto load = [&](const std::function<void(Recording&)>& change) {
    Recording other = recording;
    change(other);
    return MakePipeline(other)->LoadTracker(state.tracker);
  };
  EXPECT_EQ(load([](Recording&) {}), absl::OkStatus());
  const std::function<void(Recording&)> changes[] = {
      [](Recording& other) { other.config.encoding = Encoding::kEvt2; },
      [](Recording& other) { other.config.estimator = Estimator::kStaticM; },
      [](Recording& other) { other.config.camera.fx_px += 1.0; },
      [](Recording& other) { other.config.camera.lens_model = LensModel::kRational; },
      [](Recording& other) { other.config.sensor.blur_px += 0.1; },
      [](Recording& other) { other.config.objects[0].initial_camera_from_object = other.first_pose; },
      [](Recording& other) {
        other.config.objects[0].reference_rotation = ExpSo3({0.1, 0.0, 0.0});
      },
      [](Recording& other) {
        auto model = std::make_shared<ObjectModel>(*other.models[0]);
        model->lines[3].p1.x() += 1e-3;
        other.models = {model};
      }};
  for (const auto& change : changes) {
    EXPECT_EQ(load(change),
              absl::DataLossError("the tracker's state belongs to another configuration or another model"));
  }
}

TEST(SessionPipelineStateTest, AnotherVersionOfTheTrackersStateIsRefused) {
  PipelineState state = MakePipeline(Vga())->SaveState();
  const uint32_t version = std::exchange(state.tracker.version, 77);
  EXPECT_EQ(
      MakePipeline(Vga())->LoadTracker(state.tracker),
      absl::DataLossError(absl::StrCat("the tracker's state has version 77, this server reads version ", version)));
  state.tracker.version = version;
  state.tracker.bytes += "x";
  EXPECT_THAT(MakePipeline(Vga())->LoadTracker(state.tracker).ToString(),
              HasSubstr("1 bytes remain after the last field"));
}

// Decoder and clock continue, the tracker searches for every object, and its state is readable.
TEST(SessionPipelineStateTest, ASearchContinuesAtThePosition) {
  Recording recording = Vga();
  recording.config.objects[0].initial_camera_from_object = recording.first_pose;
  const std::vector<uint8_t> bytes = Encoded(recording, recording.config.encoding);
  const auto first = absl::MakeConstSpan(bytes).first(bytes.size() / 3);
  const auto whole = MakePipeline(recording);
  PipelineOutput output;
  whole->Process(first, output);
  const auto searching = SessionPipeline::CreateSearching(recording.config, recording.models, MakeTracker).value();
  ASSERT_EQ(searching->LoadPosition(whole->SaveState().position), absl::OkStatus());
  EXPECT_EQ(searching->tracker().state(), TrackState::kInitializing);
  EXPECT_EQ(searching->counts(), whole->counts());
  EXPECT_EQ(searching->now_us(), whole->now_us());
  const auto next = MakePipeline(recording);
  EXPECT_EQ(Load(searching->SaveState(), *next), absl::OkStatus());
  EXPECT_TRUE(next->SaveState() == searching->SaveState());
  PipelineOutput searched, next_output;
  for (SessionPipeline* pipeline : {whole.get(), searching.get(), next.get()}) {
    output.clear();
    pipeline->Process(absl::MakeConstSpan(bytes).subspan(first.size()), pipeline == whole.get()  ? output
                                                                        : pipeline == next.get() ? next_output
                                                                                                 : searched);
  }
  EXPECT_EQ(searching->counts(), whole->counts()) << "decoding continues at the same position";
  EXPECT_EQ(TakeBytes(next_output), TakeBytes(searched));
}

// The sensor and the event rate are those for which the limit of a checkpoint is intended.
TEST(SessionPipelineStateTest, ACheckpointIsSmall) {
  const Recording recording = Simulated("evk4", 100'000);
  const std::vector<uint8_t> bytes = Encoded(recording, recording.config.encoding);
  const auto pipeline = MakePipeline(recording);
  PipelineOutput output;
  size_t largest = 0;
  double longest_ms = 0.0, longest_load_ms = 0.0;
  for (size_t begin = 0; begin < bytes.size(); begin += 40'000) {
    pipeline->Process(absl::MakeConstSpan(bytes).subspan(begin, 40'000), output);
    const auto start = std::chrono::steady_clock::now();
    const PipelineState state = pipeline->SaveState();
    const auto saved = std::chrono::steady_clock::now();
    if (begin % 80'000 == 0) {
      const auto loaded = MakePipeline(recording);
      const auto load_start = std::chrono::steady_clock::now();
      ASSERT_TRUE(Load(state, *loaded).ok());
      const std::chrono::duration<double, std::milli> load_ms = std::chrono::steady_clock::now() - load_start;
      longest_load_ms = std::max(longest_load_ms, load_ms.count());
    }
    largest = std::max(largest, state.tracker.bytes.size());
    longest_ms = std::max(longest_ms, std::chrono::duration<double, std::milli>(saved - start).count());
  }
  EXPECT_FALSE(output.poses.empty()) << "the first pose is found";
  std::cout << "of " << recording.events.size() << " events in 0.1 s: at most " << largest << " bytes; now "
            << pipeline->SaveState().tracker.bytes.size() << "; saved in at most " << longest_ms
            << " ms, loaded in at most " << longest_load_ms << " ms\n";
  EXPECT_LT(largest, size_t{1} << 20);
  EXPECT_LT(pipeline->SaveState().tracker.bytes.size(), 250'000u);
}

}  // namespace
}  // namespace evpose::server
