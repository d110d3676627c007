// SPDX-License-Identifier: Apache-2.0

// The phases of one hypothesis, and the states that are reported with its poses, on ideal events that cause the
// transitions of the table in core/tracking/README.md, section 3: rest, occlusion, partial support, contradiction and
// failure. Where the evidence stays near a threshold for several tests, the sequence depends on the seed of the events;
// then the transitions are required of a part of the seeds, and the states and losses of all.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <utility>
#include <variant>
#include <vector>

#include "core/estimation/ideal_events_testing.h"
#include "core/estimation/mixture_estimator.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using ::testing::Contains;
using ::testing::ElementsAre;
using testing::HiddenBehind;
using testing::IdealEventOptions;
using ::testing::IsEmpty;
using testing::MakeIdealEvents;
using testing::MakePose;
using testing::MergeEvents;
using testing::Motion;

using Phase = TrackPhase;
using State = TrackState;

constexpr uint64_t kSeeds[] = {1, 2, 3};
// A sequence that depends on the seed must occur for so many of these.
constexpr int kMinSeeds = 2;
constexpr uint64_t kMoreSeeds[] = {1, 2, 3, 4, 5, 6};

// What a listener saw of the last of the objects of a tracker, and the estimates of that object.
struct PhaseSequence {
  std::vector<Phase> phases;      // after each transition
  std::vector<int64_t> times_us;  // sensor time of each transition
  std::vector<State> states;      // of the estimates, each once until it changes
  InitializationReport report;    // at the end
  uint32_t losses = 0;
};

// Tracks objects from given poses without rivals, so that each has one hypothesis.
PhaseSequence FollowPhases(const std::vector<ObjectToTrack>& objects, const std::vector<Event>& events) {
  TrackerOptions options = WithoutInitialization();
  options.estimator_factory = MakeMixtureEstimator;  // published estimators have no rivals
  const auto tracker = Tracker::Create(objects, kCamera, options).value();
  const auto last = static_cast<uint32_t>(objects.size() - 1);
  PhaseSequence sequence;
  Phase phase = Phase::kTentative;
  tracker->SetPhaseListener([&](const PhaseTransition& transition) {
    const auto* change = std::get_if<TrackTransition>(&transition.change);
    if (change == nullptr || transition.object_index != last) return;
    EXPECT_EQ(change->from, phase);
    phase = change->to;
    sequence.phases.push_back(phase);
    sequence.times_us.push_back(transition.t_us);
  });
  std::vector<PoseEstimate> estimates;
  tracker->AddEvents(events, estimates);
  tracker->Finish(estimates);
  for (const PoseEstimate& estimate : estimates) {
    if (estimate.object_index != last) continue;
    if (sequence.states.empty() || sequence.states.back() != estimate.state) sequence.states.push_back(estimate.state);
  }
  sequence.report = tracker->initialization(last);
  sequence.losses = tracker->losses(last);
  return sequence;
}

ObjectToTrack ObjectAt(const std::shared_ptr<const ObjectModel>& model, const Motion& motion) {
  ObjectToTrack object;
  object.model = model;
  object.initial_camera_from_object = motion(0.0);
  return object;
}

// Whether the object passes through these phases, one directly after the other.
bool PassesThrough(const PhaseSequence& sequence, const std::vector<Phase>& phases) {
  const auto& all = sequence.phases;
  return std::search(all.begin(), all.end(), phases.begin(), phases.end()) != all.end();
}

// The cube of most tests.
PhaseSequence FollowCubePhases(const std::vector<Event>& events) {
  return FollowPhases({ObjectAt(Cube(), [](double) { return kStart; })}, events);
}

const Motion kMotion = ConstantTwist(kStart, Twist(0.3, 0.15, 0.05, 0.5, 0.3, 0.6));

std::vector<Event> EventsOfCube(const Motion& motion, IdealEventOptions options) {
  options.clutter_per_s = 2e4;
  return MakeIdealEvents(*Cube(), kCamera, motion, options);
}

// The cube hidden from 60 ms on for this time, and meanwhile clutter at this rate.
std::vector<Event> HiddenInClutter(int64_t hidden_us, double clutter_per_s, uint64_t seed) {
  constexpr int64_t kBeginUs = 60'000;
  IdealEventOptions options;
  options.duration_us = 160'000;
  options.seed = seed;
  options.is_hidden = [=](const Eigen::Vector2d&, double t_s) {
    return t_s >= 1e-6 * kBeginUs && t_s < 1e-6 * static_cast<double>(kBeginUs + hidden_us);
  };
  IdealEventOptions clutter;
  clutter.events_per_px2 = 0.0;
  clutter.clutter_per_s = clutter_per_s;
  clutter.t_begin_us = kBeginUs;
  clutter.duration_us = hidden_us;
  clutter.seed = seed;
  return MergeEvents({EventsOfCube(kMotion, options), MakeIdealEvents(*Cube(), kCamera, kMotion, clutter)});
}

// A cube that is not tracked passes before the tracked one, hides its events and has events of its own.
std::vector<Event> BehindAPassingCube(double edge_m, double speed_m_per_s, uint64_t seed) {
  const auto passing = Cube(edge_m);
  const Motion motion = [=](double t) { return MakePose({speed_m_per_s * (t - 0.16), 0.0, 0.4}, {0.5 + t, 0.4, 0.2}); };
  IdealEventOptions options;
  options.duration_us = 320'000;
  options.seed = seed;
  options.is_hidden = HiddenBehind(*passing, kCamera, motion);
  IdealEventOptions before;
  before.duration_us = options.duration_us;
  before.clutter_per_s = 0.0;
  before.seed = 10 + seed;
  return MergeEvents({MakeIdealEvents(*passing, kCamera, motion, before), EventsOfCube(kMotion, options)});
}

// A small cube that moves to the left behind a larger one that moves to the right. Both are tracked.
PhaseSequence FollowBehindATrackedCube(double edge_m, uint64_t seed) {
  const auto passing = [](double vx_m_per_s, double z_m, double turn_rad_per_s) {
    return [=](double t) {
      return MakePose({vx_m_per_s * (t - 0.15), 0.01 * std::sin(9.0 * t), z_m},
                      {0.5 + turn_rad_per_s * t, 0.4 + 0.5 * turn_rad_per_s * t, 0.2});
    };
  };
  const Motion near = passing(2.0, 0.5, 1.0), far = passing(-1.0, 1.0, -0.8);
  const auto near_cube = Cube(edge_m), far_cube = Cube(0.08);
  IdealEventOptions options;
  options.duration_us = 250'000;
  options.clutter_per_s = 2e4;
  options.seed = 10 + seed;
  const std::vector<Event> near_events = MakeIdealEvents(*near_cube, kCamera, near, options);
  options.clutter_per_s = 0.0;
  options.seed = 20 + seed;
  options.is_hidden = HiddenBehind(*near_cube, kCamera, near);
  return FollowPhases({ObjectAt(near_cube, near), ObjectAt(far_cube, far)},
                      MergeEvents({near_events, MakeIdealEvents(*far_cube, kCamera, far, options)}));
}

// The pose is confirmed first and never lost. The test may end while it is confirmed again.
void ExpectNoLoss(const PhaseSequence& sequence, uint64_t seed) {
  ASSERT_FALSE(sequence.phases.empty()) << seed;
  EXPECT_EQ(sequence.phases.front(), Phase::kConfirmed) << seed;
  EXPECT_THAT(sequence.states, Contains(State::kDegraded)) << seed;
  EXPECT_EQ(sequence.losses, 0u) << seed;
}

void ExpectReturn(const PhaseSequence& sequence, uint64_t seed) {
  ExpectNoLoss(sequence, seed);
  EXPECT_EQ(sequence.states.back(), State::kTracking) << seed;
}

TEST(PhaseSequences, AtRestAPoseCoasts) {
  for (const uint64_t seed : kSeeds) {
    IdealEventOptions options;
    options.duration_us = 280'000;
    options.seed = seed;
    const Motion motion = [](double t) { return kMotion(t < 0.08 ? t : t < 0.2 ? 0.08 : t - 0.12); };
    const PhaseSequence sequence = FollowCubePhases(EventsOfCube(motion, options));
    EXPECT_THAT(sequence.phases, ElementsAre(Phase::kConfirmed, Phase::kCoasting, Phase::kConfirmed)) << seed;
    EXPECT_THAT(sequence.states, ElementsAre(State::kTracking, State::kDegraded, State::kTracking)) << seed;
    ASSERT_EQ(sequence.times_us.size(), 3u);
    EXPECT_GT(sequence.times_us[1], 80'000) << "it rests from here on";
    EXPECT_GT(sequence.times_us[2], 200'000) << "it moves again";
  }
}

TEST(PhaseSequences, BehindATrackedObjectAPoseIsOccludedAndReturns) {
  int passed = 0;
  for (const uint64_t seed : kMoreSeeds) {
    const PhaseSequence sequence = FollowBehindATrackedCube(0.12, seed);
    // When it returns, a part is seen first.
    passed += PassesThrough(sequence, {Phase::kConfirmed, Phase::kOccluded, Phase::kDoubtful, Phase::kConfirmed});
    ExpectReturn(sequence, seed);
  }
  EXPECT_GE(passed, kMinSeeds);
}

TEST(PhaseSequences, ADoubtfulPoseStaysDoubtfulWhileItIsOccluded) {
  int passed = 0;
  for (const uint64_t seed : kMoreSeeds) {
    // The wider object hides the other one more slowly, so that a part of it is tested meanwhile.
    const PhaseSequence sequence = FollowBehindATrackedCube(0.16, seed);
    passed += PassesThrough(sequence, {Phase::kConfirmed, Phase::kDoubtful, Phase::kConfirmed});
    ExpectReturn(sequence, seed);
  }
  EXPECT_GE(passed, kMinSeeds);
}

TEST(PhaseSequences, APoseThatIsSupportedInPartIsDoubtfulAndRecovers) {
  for (const uint64_t seed : kSeeds) {
    const PhaseSequence sequence = FollowCubePhases(BehindAPassingCube(0.08, 1.6, seed));
    EXPECT_THAT(sequence.phases, ElementsAre(Phase::kConfirmed, Phase::kDoubtful, Phase::kConfirmed)) << seed;
    EXPECT_THAT(sequence.states, ElementsAre(State::kTracking, State::kDegraded, State::kTracking)) << seed;
    EXPECT_EQ(sequence.losses, 0u);
  }
}

TEST(PhaseSequences, ATentativePoseThatIsSupportedInPartIsReportedAsDegraded) {
  for (const uint64_t seed : kSeeds) {
    const PhaseSequence sequence = FollowCubePhases(BehindAPassingCube(0.08, 0.4, seed));
    ASSERT_GE(sequence.phases.size(), 2u) << seed;
    EXPECT_EQ(sequence.phases[0], Phase::kDoubtful) << seed;
    EXPECT_EQ(sequence.phases[1], Phase::kConfirmed) << seed;
    EXPECT_EQ(sequence.states.front(), State::kDegraded) << seed;
    EXPECT_EQ(sequence.states.back(), State::kTracking) << seed;
  }
}

TEST(PhaseSequences, ADoubtfulPoseThatFollowsAnotherObjectIsContradictedAndLost) {
  int lost = 0;
  for (const uint64_t seed : kMoreSeeds) {
    const PhaseSequence sequence = FollowCubePhases(BehindAPassingCube(0.12, 1.6, seed));
    EXPECT_TRUE(PassesThrough(sequence, {Phase::kConfirmed, Phase::kDoubtful})) << seed;
    if (sequence.phases.back() != Phase::kLost) continue;  // it recovers
    lost += PassesThrough(sequence, {Phase::kDoubtful, Phase::kUnsupported, Phase::kLost});
    EXPECT_EQ(sequence.states.back(), State::kDegraded) << "no pose is reported after the loss, " << seed;
    EXPECT_EQ(sequence.report.loss_cause, LossCause::kContradicted) << seed;
  }
  EXPECT_GE(lost, kMinSeeds);
}

TEST(PhaseSequences, AContradictionThatEndsBeforeTheTimeoutIsNoLoss) {
  for (const uint64_t seed : kSeeds) {
    // The cube is turned by 0.57 rad for 15 ms.
    const Motion motion = [](double t) {
      RigidTransform pose = kMotion(t);
      if (t >= 0.06 && t < 0.075) pose.rotation = pose.rotation * ExpSo3({0.4, 0.4, 0.0});
      return pose;
    };
    IdealEventOptions options;
    options.duration_us = 160'000;
    options.seed = seed;
    const PhaseSequence sequence = FollowCubePhases(EventsOfCube(motion, options));
    EXPECT_THAT(sequence.phases, ElementsAre(Phase::kConfirmed, Phase::kUnsupported, Phase::kConfirmed)) << seed;
    EXPECT_THAT(sequence.states, ElementsAre(State::kTracking, State::kDegraded, State::kTracking)) << seed;
    EXPECT_EQ(sequence.losses, 0u);
  }
}

TEST(PhaseSequences, AContradictionUntilTheTimeoutIsALoss) {
  const int64_t lost_after_us = HealthOptions().lost_after_us;
  for (const uint64_t seed : kSeeds) {
    const PhaseSequence sequence = FollowCubePhases(HiddenInClutter(60'000, 5e6, seed));
    ASSERT_THAT(sequence.phases, ElementsAre(Phase::kConfirmed, Phase::kUnsupported, Phase::kLost)) << seed;
    EXPECT_THAT(sequence.states, ElementsAre(State::kTracking, State::kDegraded)) << seed;
    const int64_t contradicted_us = sequence.times_us[2] - sequence.times_us[1];
    EXPECT_GE(contradicted_us, lost_after_us) << seed;
    EXPECT_LE(contradicted_us, lost_after_us + 10'000) << "the next test result, " << seed;
    EXPECT_EQ(sequence.report.loss_cause, LossCause::kContradicted);
    EXPECT_EQ(sequence.report.lost_at_us, sequence.times_us[2]);
    EXPECT_EQ(sequence.losses, 1u);
  }
}

TEST(PhaseSequences, AContradictedPoseThatIsSupportedInPartIsDoubtful) {
  int passed = 0;
  for (const uint64_t seed : kMoreSeeds) {
    const PhaseSequence sequence = FollowCubePhases(HiddenInClutter(15'000, 5e6, seed));
    passed += PassesThrough(sequence, {Phase::kConfirmed, Phase::kUnsupported, Phase::kDoubtful, Phase::kConfirmed});
    ExpectNoLoss(sequence, seed);
  }
  EXPECT_GE(passed, kMinSeeds);
}

TEST(PhaseSequences, ACoastingPoseIsContradictedByTheEventsOfTheReturnedObject) {
  int passed = 0;
  for (const uint64_t seed : kMoreSeeds) {
    // The clutter is too sparse to contradict the pose, which has another motion than the object meanwhile.
    const PhaseSequence sequence = FollowCubePhases(HiddenInClutter(15'000, 1e6, seed));
    passed += PassesThrough(sequence, {Phase::kConfirmed, Phase::kCoasting, Phase::kUnsupported, Phase::kDoubtful});
    ExpectNoLoss(sequence, seed);
  }
  EXPECT_GE(passed, kMinSeeds);
}

TEST(PhaseSequences, AnObjectThatLeavesTheImageIsLostByAFailure) {
  for (const uint64_t seed : kSeeds) {
    IdealEventOptions options;
    options.duration_us = 250'000;
    options.seed = seed;
    const Motion motion = ConstantTwist(kStart, Twist(3.0, 0.0, 0.0, 0.0, 0.0, 0.0));
    const PhaseSequence sequence = FollowCubePhases(EventsOfCube(motion, options));
    EXPECT_THAT(sequence.phases, ElementsAre(Phase::kConfirmed, Phase::kDoubtful, Phase::kLost)) << seed;
    EXPECT_THAT(sequence.states, ElementsAre(State::kTracking, State::kDegraded)) << seed;
    EXPECT_EQ(sequence.report.loss_cause, LossCause::kOutOfView);
  }
}

TEST(PhaseSequences, AWrongGivenPoseIsLostWithoutAnEstimate) {
  for (const uint64_t seed : kSeeds) {
    IdealEventOptions options;
    options.duration_us = 100'000;
    options.seed = seed;
    const Motion elsewhere =
        ConstantTwist(MakePose({0.2, 0.1, 0.9}, {0.1, 0.2, 0.3}), Twist(0.3, 0.15, 0.05, 0.5, 0.3, 0.6));
    const PhaseSequence sequence = FollowCubePhases(EventsOfCube(elsewhere, options));
    EXPECT_THAT(sequence.phases, ElementsAre(Phase::kLost)) << seed;
    EXPECT_THAT(sequence.states, IsEmpty()) << seed;
    EXPECT_EQ(sequence.report.loss_cause, LossCause::kContradicted);
    EXPECT_EQ(sequence.losses, 1u);
  }
}

}  // namespace
}  // namespace evpose
