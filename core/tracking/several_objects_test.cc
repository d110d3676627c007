// SPDX-License-Identifier: Apache-2.0

// Several objects in one stream, on ideal events: they pass each other, occlude each other and are searched for
// together.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "core/estimation/ideal_events_testing.h"
#include "core/models/symmetry.h"
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

struct Actor {
  std::shared_ptr<const ObjectModel> model;
  Motion motion;
};

// Moves sideways at this speed while it rotates; it is in the middle of the image at t_middle_s.
Motion Passing(double vx_m_per_s, double y_m, double z_m, double t_middle_s, double turn_rad_per_s) {
  return [=](double t) {
    return MakePose({vx_m_per_s * (t - t_middle_s), y_m + 0.01 * std::sin(9.0 * t), z_m},
                    {0.5 + turn_rad_per_s * t, 0.4 + 0.5 * turn_rad_per_s * t, 0.2});
  };
}

// Ideal events of all objects, in order of time. The first object occludes the others.
std::vector<Event> EventsOf(const std::vector<Actor>& actors, int64_t duration_us, double clutter_per_s = 50'000.0) {
  std::vector<std::vector<Event>> streams;
  for (size_t i = 0; i < actors.size(); ++i) {
    IdealEventOptions options;
    options.duration_us = duration_us;
    options.seed = 11 + i;
    options.clutter_per_s = i == 0 ? clutter_per_s : 0.0;
    if (i > 0) options.is_hidden = HiddenBehind(*actors[0].model, kCamera, actors[0].motion);
    streams.push_back(MakeIdealEvents(*actors[i].model, kCamera, actors[i].motion, options));
  }
  return MergeEvents(streams);
}

std::unique_ptr<Tracker> MakeTracker(const std::vector<Actor>& actors, bool with_poses) {
  std::vector<ObjectToTrack> objects;
  for (const Actor& actor : actors) {
    ObjectToTrack object;
    object.model = actor.model;
    if (with_poses) object.initial_camera_from_object = actor.motion(0.0);
    object.reference_rotation = actor.motion(0.0).rotation;
    objects.push_back(object);
  }
  return Tracker::Create(std::move(objects), kCamera, IdealSensor()).value();
}

std::vector<PoseEstimate> Track(Tracker& tracker, const std::vector<Event>& events, size_t step = 100'000) {
  std::vector<PoseEstimate> estimates;
  for (size_t i = 0; i < events.size(); i += step) {
    tracker.AddEvents(absl::MakeConstSpan(events).subspan(i, step), estimates);
  }
  tracker.Finish(estimates);
  return estimates;
}

struct ObjectErrors {
  size_t num_poses = 0;
  double position_rmse_of_depth = 0.0;
  double position_max_of_depth = 0.0;
  double rotation_max_rad = 0.0;
};

ObjectErrors Compare(const std::vector<PoseEstimate>& estimates, uint32_t object_index, const Actor& actor) {
  ObjectErrors errors;
  for (const PoseEstimate& estimate : estimates) {
    if (estimate.object_index != object_index) continue;
    const RigidTransform truth = NearestEquivalent(actor.motion(static_cast<double>(estimate.t_us) * 1e-6),
                                                   actor.model->symmetries, estimate.camera_from_object);
    const double ratio =
        (estimate.camera_from_object.translation_m - truth.translation_m).norm() / truth.translation_m.norm();
    ++errors.num_poses;
    errors.position_rmse_of_depth += ratio * ratio;
    errors.position_max_of_depth = std::max(errors.position_max_of_depth, ratio);
    errors.rotation_max_rad =
        std::max(errors.rotation_max_rad, RotationAngle(truth.rotation, estimate.camera_from_object.rotation));
  }
  errors.position_rmse_of_depth = std::sqrt(errors.position_rmse_of_depth / static_cast<double>(errors.num_poses));
  return errors;
}

void ExpectSamePose(const PoseEstimate& a, const PoseEstimate& b) {
  EXPECT_EQ(a.t_us, b.t_us);
  EXPECT_EQ(a.camera_from_object.translation_m, b.camera_from_object.translation_m);
  EXPECT_EQ(a.camera_from_object.rotation, b.camera_from_object.rotation);
  EXPECT_EQ(a.covariance, b.covariance);
  EXPECT_EQ(a.twist, b.twist);
  EXPECT_EQ(a.state, b.state);
  EXPECT_EQ(a.num_events, b.num_events);
}

void ExpectTrackedThroughout(const std::vector<Actor>& actors, const Tracker& tracker,
                             const std::vector<PoseEstimate>& estimates) {
  for (uint32_t i = 0; i < actors.size(); ++i) {
    EXPECT_EQ(tracker.state(i), TrackState::kTracking) << i;
    EXPECT_EQ(tracker.losses(i), 0u) << i;
    const ObjectErrors errors = Compare(estimates, i, actors[i]);
    EXPECT_GT(errors.num_poses, 350u) << i;
    EXPECT_LT(errors.position_rmse_of_depth, 2e-3) << i;
    EXPECT_LT(errors.position_max_of_depth, 1.5e-2) << i;
    EXPECT_LT(errors.rotation_max_rad, 0.05) << i;
  }
}

// They meet after 0.2 s: the near object covers most of the far one.
const std::vector<Actor>& Crossing() {
  static const std::vector<Actor> actors = {{Cube(0.12), Passing(0.5, 0.0, 0.6, 0.2, 1.0)},
                                            {Cube(0.20), Passing(-0.5, 0.02, 1.0, 0.2, -0.8)}};
  return actors;
}

TEST(SeveralObjects, AreTrackedWhileOnePassesBeforeTheOther) {
  const auto tracker = MakeTracker(Crossing(), true);
  ExpectTrackedThroughout(Crossing(), *tracker, Track(*tracker, EventsOf(Crossing(), 400'000)));
}

TEST(SeveralObjects, OfOneModelAreNotConfused) {
  const auto cube = Cube(0.15);
  const std::vector<Actor> actors = {{cube, Passing(0.45, 0.0, 0.6, 0.2, 1.0)},
                                     {cube, Passing(-0.45, 0.07, 0.85, 0.2, 0.7)}};
  const auto tracker = MakeTracker(actors, true);
  ExpectTrackedThroughout(actors, *tracker, Track(*tracker, EventsOf(actors, 400'000)));
}

TEST(SeveralObjects, AnOccludedOneIsHeldAndContinues) {
  const std::vector<Actor> actors = {{Cube(0.12), Passing(1.5, 0.0, 0.5, 0.2, 1.0)},
                                     {Cube(0.08), Passing(-0.3, 0.0, 1.0, 0.2, -0.8)}};
  const auto tracker = MakeTracker(actors, true);
  // After 390 ms only a corner of the near one is left in the view, which does not determine its depth.
  const std::vector<PoseEstimate> estimates = Track(*tracker, EventsOf(actors, 385'000));
  for (uint32_t i = 0; i < 2; ++i) {
    EXPECT_EQ(tracker->state(i), TrackState::kTracking) << i;
    EXPECT_EQ(tracker->losses(i), 0u) << i;
    EXPECT_LT(Compare(estimates, i, actors[i]).position_max_of_depth, 0.03) << i;
  }
  size_t held = 0;
  double before = 0.0, after = 0.0;
  for (const PoseEstimate& estimate : estimates) {
    if (estimate.object_index != 1) continue;
    if (estimate.num_events > 0 || estimate.state != TrackState::kDegraded) {
      if (held == 0) before = estimate.covariance.trace();
      continue;
    }
    ++held;
    after = estimate.covariance.trace();
  }
  EXPECT_GT(held, 3u);
  EXPECT_GT(after, 2.0 * before) << "the object was occluded";
}

TEST(SeveralObjects, PosesDoNotDependOnTheCutOfCallsNorOnTheOrderOfTheObjects) {
  const std::vector<Actor> swapped = {Crossing()[1], Crossing()[0]};
  const std::vector<Event> events = EventsOf(Crossing(), 250'000);
  const auto whole = MakeTracker(Crossing(), true);
  const std::vector<PoseEstimate> expected = Track(*whole, events);
  for (const size_t step : {7u, 1000u}) {
    const auto tracker = MakeTracker(Crossing(), true);
    const std::vector<PoseEstimate> estimates = Track(*tracker, events, step);
    ASSERT_EQ(estimates.size(), expected.size());
    for (size_t k = 0; k < estimates.size(); ++k) {
      EXPECT_EQ(estimates[k].object_index, expected[k].object_index);
      ExpectSamePose(estimates[k], expected[k]);
    }
  }
  const auto other = MakeTracker(swapped, true);
  std::vector<PoseEstimate> estimates = Track(*other, events);
  for (PoseEstimate& estimate : estimates) estimate.object_index = 1 - estimate.object_index;
  std::stable_sort(estimates.begin(), estimates.end(), [](const PoseEstimate& a, const PoseEstimate& b) {
    return std::make_pair(a.t_us, a.object_index) < std::make_pair(b.t_us, b.object_index);
  });
  ASSERT_EQ(estimates.size(), expected.size());
  for (size_t k = 0; k < estimates.size(); ++k) ExpectSamePose(estimates[k], expected[k]);
}

TEST(SeveralObjects, AreBothFoundWithoutGivenPoses) {
  const auto cube = Cube(0.15);
  const std::vector<Actor> actors = {{cube, Passing(0.4, -0.03, 0.6, 0.45, 1.0)},
                                     {cube, Passing(-0.4, 0.05, 0.8, 0.45, 0.7)}};
  const auto tracker = MakeTracker(actors, false);
  const std::vector<PoseEstimate> estimates = Track(*tracker, EventsOf(actors, 250'000));
  for (uint32_t i = 0; i < 2; ++i) {
    EXPECT_EQ(tracker->state(i), TrackState::kTracking) << i;
    EXPECT_EQ(tracker->losses(i), 0u) << i;
  }
  // The assignment of the two equal objects is arbitrary, but it must not change.
  const uint32_t first = Compare(estimates, 0, actors[0]).position_max_of_depth < 0.05 ? 0 : 1;
  EXPECT_LT(Compare(estimates, 0, actors[first]).position_max_of_depth, 0.05);
  EXPECT_LT(Compare(estimates, 1, actors[1 - first]).position_max_of_depth, 0.05);
}

TEST(SeveralObjects, AnAbsentOneIsNotFoundInAnother) {
  const auto cube = Cube(0.15);
  const std::vector<Actor> actors = {{cube, Passing(0.4, 0.0, 0.6, 0.15, 1.0)}};
  const std::vector<Event> events = EventsOf(actors, 300'000);
  for (const bool with_pose : {true, false}) {
    std::vector<ObjectToTrack> objects(2);
    objects[0].model = objects[1].model = cube;
    if (with_pose) objects[0].initial_camera_from_object = actors[0].motion(0.0);
    const auto tracker = Tracker::Create(objects, kCamera, IdealSensor()).value();
    const std::vector<PoseEstimate> estimates = Track(*tracker, events);
    EXPECT_EQ(tracker->state(0), TrackState::kTracking);
    EXPECT_EQ(tracker->state(1), TrackState::kInitializing);
    EXPECT_TRUE(std::none_of(estimates.begin(), estimates.end(), [](const auto& e) { return e.object_index == 1; }));
  }
}

TEST(SeveralObjects, ADistantOneHasNoInfluence) {
  const std::vector<Actor> actors = {{Cube(0.10),
                                      [](double t) {
                                        return MakePose({-0.2 + 0.1 * t, 0.0, 0.6}, {0.5 + t, 0.4, 0.2});
                                      }},
                                     {Cube(0.12), [](double t) {
                                        return MakePose({0.2 + 0.1 * t, 0.02, 0.7}, {0.3, 0.4 + t, 0.1});
                                      }}};
  const std::vector<Event> events = EventsOf(actors, 150'000);
  const auto both = MakeTracker(actors, true);
  const auto alone = MakeTracker({actors[0]}, true);
  std::vector<PoseEstimate> estimates = Track(*both, events);
  std::erase_if(estimates, [](const PoseEstimate& estimate) { return estimate.object_index != 0; });
  const std::vector<PoseEstimate> expected = Track(*alone, events);
  ASSERT_EQ(estimates.size(), expected.size());
  ASSERT_GT(expected.size(), 50u);
  for (size_t k = 0; k < estimates.size(); ++k) ExpectSamePose(estimates[k], expected[k]);
}

}  // namespace
}  // namespace evpose
