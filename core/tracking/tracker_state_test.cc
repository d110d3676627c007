// SPDX-License-Identifier: Apache-2.0

// A tracker that is saved and loaded at any time continues identically, bit for bit.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "core/baselines/estimators/estimator_factory.h"
#include "core/contours/contour_shapes_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/initialization/templates/template_model.h"
#include "core/numerics/random.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using testing::HiddenBehind;
using testing::IdealEventOptions;
using testing::MakeIdealEvents;
using testing::MakePose;
using testing::MergeEvents;
using testing::Motion;

struct Scene {
  std::vector<ObjectToTrack> objects;
  TrackerOptions options;
  std::vector<Event> events;
  // Pose to which the first object is reset before the event with this number; 0: no reset.
  size_t reset_before = 0;
  RigidTransform reset_pose;
};

std::unique_ptr<Tracker> MakeTracker(const Scene& scene) {
  return Tracker::Create(scene.objects, kCamera, scene.options).value();
}

std::string Save(const Tracker& tracker) {
  StateWriter writer;
  tracker.SaveState(writer);
  return writer.Take();
}

absl::Status Load(const std::string& state, Tracker& tracker) {
  StateReader reader(state);
  tracker.LoadState(reader);
  return reader.Finish();
}

std::string Bytes(const std::vector<PoseEstimate>& estimates) {
  StateWriter writer;
  writer(estimates);
  return writer.Take();
}

// What a tracker did in one run over a stream.
struct TrackerRun {
  std::vector<PoseEstimate> estimates;
  std::vector<std::string> states;  // saved after some of the calls, chosen at random
  uint32_t losses = 0;
  uint64_t attempts = 0;
  bool was_lost = false;
  bool was_found_again = false;
};

// Processes the stream in calls of random sizes with one tracker, and with another one that is saved and loaded into a
// new tracker between all calls.
TrackerRun RunWithRestoredStates(const Scene& scene, uint64_t seed) {
  TrackerRun run;
  std::vector<PoseEstimate> restored_estimates;
  Random random(seed);
  const auto whole = MakeTracker(scene);
  auto restored = MakeTracker(scene);
  for (size_t begin = 0; begin < scene.events.size();) {
    size_t size = 1 + random.UniformInt(random.UniformInt(2) == 0 ? 300 : 12'000);
    if (begin < scene.reset_before) size = std::min(size, scene.reset_before - begin);
    const auto piece = absl::MakeConstSpan(scene.events).subspan(begin, size);
    if (scene.reset_before > 0 && begin == scene.reset_before) {
      whole->ResetPose(scene.reset_pose);
      restored->ResetPose(scene.reset_pose);
    }
    whole->AddEvents(piece, run.estimates);
    restored->AddEvents(piece, restored_estimates);
    begin += piece.size();
    if (random.UniformInt(20) == 0) {
      whole->AdvanceTime(piece.back().t_us + 1500, run.estimates);
      restored->AdvanceTime(piece.back().t_us + 1500, restored_estimates);
    }
    const std::string state = Save(*restored);
    EXPECT_TRUE(state == Save(*whole)) << "at event " << begin;
    restored = MakeTracker(scene);
    const absl::Status status = Load(state, *restored);
    EXPECT_EQ(status, absl::OkStatus()) << "at event " << begin;
    EXPECT_TRUE(Save(*restored) == state) << "at event " << begin;
    if (!status.ok() || ::testing::Test::HasFailure()) return run;
    if (random.UniformInt(8) == 0) run.states.push_back(state);
    if (restored->state() == TrackState::kLost) run.was_lost = true;
    if (run.was_lost && restored->state() == TrackState::kTracking) run.was_found_again = true;
  }
  whole->Finish(run.estimates);
  restored->Finish(restored_estimates);
  EXPECT_TRUE(Bytes(run.estimates) == Bytes(restored_estimates));
  for (size_t i = 0; i < scene.objects.size(); ++i) {
    EXPECT_EQ(restored->state(i), whole->state(i));
    EXPECT_EQ(restored->losses(i), whole->losses(i));
    EXPECT_EQ(restored->initialization(i).attempts, whole->initialization(i).attempts);
    run.losses += whole->losses(i);
    run.attempts += whole->initialization(i).attempts;
  }
  return run;
}

Motion Tumbling() {
  return [](double t) { return MakePose({0.3 * t - 0.02, 0.15 * t, 0.6}, {0.6 + 1.5 * t, 0.5 + 0.4 * t, 0.2}); };
}

// Slows down, is at rest after 0.2 s, and moves on: meanwhile its event rate passes that of the noise.
Motion RestsForAMoment() {
  return [](double t) {
    const double u = (t - 0.2) / 0.2;
    return Tumbling()(0.1 * (1.0 + u * u * u));
  };
}

void Append(const std::vector<Event>& more, std::vector<Event>& events) {
  events.insert(events.end(), more.begin(), more.end());
}

Scene OneCube(int64_t duration_us, const Motion& motion, bool with_pose) {
  Scene scene;
  scene.options.sensor = testing::UnbiasedSensor();
  ObjectToTrack object;
  object.model = Cube(0.15);
  if (with_pose) object.initial_camera_from_object = motion(0.0);
  scene.objects = {object};
  scene.events = EventsOf(*object.model, motion, 0, duration_us);
  return scene;
}

// Found, lost in so many events that windows are downsampled, absent, and back.
Scene FoundLostAndFoundAgain() {
  Scene scene = OneCube(70'000, Tumbling(), false);
  Append(Noise(5e6, 70'000, 60'000), scene.events);
  Append(Noise(50e3, 130'000, 60'000), scene.events);
  Append(EventsOf(*scene.objects[0].model, Tumbling(), 190'000, 120'000), scene.events);
  return scene;
}

// The first object passes in front of the second one and occludes most of it.
Scene Crossing(bool with_poses) {
  const auto near = Cube(0.12), far = Cube(0.2);
  const Motion motions[] = {[](double t) {
                              return MakePose({0.5 * (t - 0.1), 0.0, 0.6}, {0.5 + t, 0.4 + 0.5 * t, 0.2});
                            },
                            [](double t) {
                              return MakePose({-0.5 * (t - 0.1), 0.02, 1.0}, {0.5 - 0.8 * t, 0.4, 0.2});
                            }};
  Scene scene;
  scene.options.sensor = testing::UnbiasedSensor();
  scene.objects = {{near}, {far}};
  for (size_t i = 0; i < 2 && with_poses; ++i) scene.objects[i].initial_camera_from_object = motions[i](0.0);
  IdealEventOptions options;
  options.duration_us = 200'000;
  const std::vector<Event> before = MakeIdealEvents(*near, kCamera, motions[0], options);
  options.seed = 2;
  options.clutter_per_s = 0.0;
  options.is_hidden = HiddenBehind(*near, kCamera, motions[0]);
  scene.events = MergeEvents({before, MakeIdealEvents(*far, kCamera, motions[1], options)});
  return scene;
}

TEST(TrackerState, EveryEstimatorContinuesIdentically) {
  for (const auto& [estimator, name] : kEstimatorNames) {
    SCOPED_TRACE(std::string(name));
    Scene scene = OneCube(60'000, Tumbling(), true);
    scene.options.estimator_factory = EstimatorFactoryOf(estimator);
    EXPECT_GT(RunWithRestoredStates(scene, 1).estimates.size(), 20u);
  }
}

TEST(TrackerState, AStillObjectContinuesIdentically) {
  EXPECT_GT(RunWithRestoredStates(OneCube(400'000, RestsForAMoment(), true), 2).estimates.size(), 200u);
}

TEST(TrackerState, SearchLossAndRecoveryContinueIdentically) {
  const TrackerRun run = RunWithRestoredStates(FoundLostAndFoundAgain(), 3);
  EXPECT_TRUE(run.was_lost);
  EXPECT_TRUE(run.was_found_again);
  EXPECT_GT(run.attempts, 2u);
}

TEST(TrackerState, SeveralObjectsContinueIdentically) {
  for (const bool with_poses : {true, false}) {
    const TrackerRun run = RunWithRestoredStates(Crossing(with_poses), 4);
    for (uint32_t i = 0; i < 2; ++i) {
      EXPECT_TRUE(std::any_of(run.estimates.begin(), run.estimates.end(),
                              [i](const PoseEstimate& estimate) { return estimate.object_index == i; }));
    }
  }
}

TEST(TrackerState, AGivenPoseContinuesIdentically) {
  Scene scene = OneCube(80'000, Tumbling(), false);
  scene.reset_before = scene.events.size() / 2;
  scene.reset_pose = Tumbling()(0.04);
  EXPECT_GT(RunWithRestoredStates(scene, 5).estimates.size(), 30u);
  scene.reset_pose = MakePose({0.2, 0.1, 0.8}, {0.1, 0.2, 0.3});  // a wrong pose
  EXPECT_GT(RunWithRestoredStates(scene, 6).losses, 0u);
}

// Two round objects from given poses.
Scene RoundObjects() {
  Scene scene;
  scene.options = IdealSensor();
  const std::vector<std::shared_ptr<const ObjectModel>> models = {
      std::make_shared<const ObjectModel>(TorusModel(0.06, 0.025, 64, 32)),
      std::make_shared<const ObjectModel>(CylinderModel(0.05, 0.03, 48))};
  const std::vector<RigidTransform> starts = {MakePose({-0.08, 0.0, 0.5}, {1.0, 0.5, 0.2}),
                                              MakePose({0.1, 0.02, 0.6}, {0.9, -0.4, 0.0})};
  std::vector<std::vector<Event>> streams;
  for (size_t i = 0; i < models.size(); ++i) {
    ObjectToTrack& object = scene.objects.emplace_back(ObjectToTrack{models[i], starts[i]});
    // Prepared once, as in the server, and not for each tracker.
    object.template_model = std::make_shared<const TemplateModel>(models[i]);
    IdealEventOptions options;
    options.duration_us = 300'000;
    options.seed = i + 1;
    streams.push_back(MakeIdealEvents(
        *models[i], kCamera, testing::ConstantTwist(starts[i], Twist(0.15, 0.1, 0.0, 0.8, -1.0, 0.5)), options));
  }
  scene.events = MergeEvents(streams);
  return scene;
}

TEST(TrackerState, RoundObjectsContinueIdentically) {
  EXPECT_GT(RunWithRestoredStates(RoundObjects(), 10).estimates.size(), 100u);
}

// A damaged state is rejected, or the tracker processes the following events without a failure.
void TryDamaged(const Scene& scene, const std::string& damaged, absl::Span<const Event> events, int* num_loaded) {
  const auto tracker = MakeTracker(scene);
  const absl::Status status = Load(damaged, *tracker);
  if (!status.ok()) {
    ASSERT_EQ(status.code(), absl::StatusCode::kDataLoss);
    return;
  }
  ++*num_loaded;
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(events, estimates);
  tracker->ResetPose(MakePose({0.0, 0.0, 0.6}, {0.6, 0.5, 0.2}));
  tracker->AdvanceTime(events.back().t_us + 30'000, estimates);
  tracker->Finish(estimates);
  ASSERT_LE(estimates.size(), 1000u);
}

TEST(TrackerState, DamagedStatesAreRejectedOrTracked) {
  Random random(7);
  for (const Scene& scene : {FoundLostAndFoundAgain(), Crossing(true), RoundObjects()}) {
    const TrackerRun run = RunWithRestoredStates(scene, 8);
    int num_loaded = 0;
    for (int i = 0; i < 40; ++i) {
      const std::string& state = run.states[random.UniformInt(run.states.size())];
      // Any events will do: the estimates after a damaged state are not compared.
      const auto events =
          absl::MakeConstSpan(scene.events).subspan(random.UniformInt(scene.events.size() - 3000), 3000);
      std::string damaged = state;
      if (i % 10 == 0) {
        damaged.resize(random.UniformInt(state.size()));
        TryDamaged(scene, damaged, events, &num_loaded);
        continue;
      }
      // Skips most of the stored events, which are the largest and least critical part of the state.
      for (int flips = 1 + i % 3; flips > 0; --flips) {
        const size_t last = i % 2 == 0 ? state.size() : std::min<size_t>(state.size(), 8000);
        damaged[damaged.size() - 1 - random.UniformInt(last)] ^= static_cast<char>(1 << random.UniformInt(8));
      }
      TryDamaged(scene, damaged, events, &num_loaded);
    }
    EXPECT_GT(num_loaded, 10);
    EXPECT_LT(num_loaded, 40);
  }
}

TEST(TrackerState, TruncatedStatesAreRejected) {
  const Scene scene = Crossing(true);
  const TrackerRun run = RunWithRestoredStates(scene, 9);
  const std::string& state = run.states.back();
  for (size_t size = 0; size < state.size(); size += 1 + state.size() / 10) {
    EXPECT_EQ(Load(state.substr(0, size), *MakeTracker(scene)).code(), absl::StatusCode::kDataLoss) << size;
  }
}

}  // namespace
}  // namespace evpose
