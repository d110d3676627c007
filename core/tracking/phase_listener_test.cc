// SPDX-License-Identifier: Apache-2.0

// The transitions that a tracker reports on ideal events: they form a chain for each object, the transition functions
// allow each of them, and the estimates do not depend on the listener.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using testing::IdealEventOptions;
using ::testing::IsSupersetOf;
using testing::MakeCube;
using testing::MakeIdealEvents;
using testing::MakePose;

std::unique_ptr<Tracker> MakeTracker(const std::optional<RigidTransform>& initial = std::nullopt) {
  return Tracker::Create(Cube(), kCamera, IdealSensor(), initial).value();
}

// A part of a stream with this event density of the cube and this rate of clutter. At density 0 the cube is at rest.
struct Part {
  int64_t duration_us;
  double events_per_px2;
  double clutter_per_s;
  bool begins_at_start = false;  // the cube jumps back to its first pose
};

std::vector<Event> MakeStream(const std::vector<Part>& parts) {
  Vector6d twist;
  twist << 0.3, 0.15, 0.05, 0.5, 0.3, 0.6;
  const RigidTransform first = MakePose({0.02, -0.01, 0.6}, {0.6, 0.5, 0.2});
  RigidTransform start = first;
  std::vector<Event> stream;
  IdealEventOptions options;
  for (const Part& part : parts) {
    options.duration_us = part.duration_us;
    options.events_per_px2 = part.events_per_px2;
    options.clutter_per_s = part.clutter_per_s;
    if (part.begins_at_start) start = first;
    const auto motion = ConstantTwist(start, twist);
    const std::vector<Event> events = MakeIdealEvents(*MakeCube(0.15), kCamera, motion, options);
    stream.insert(stream.end(), events.begin(), events.end());
    options.t_begin_us += part.duration_us;
    if (part.events_per_px2 > 0.0) start = motion(1e-6 * static_cast<double>(part.duration_us));
  }
  return stream;
}

struct TrackedStream {
  std::vector<PhaseTransition> transitions;
  std::vector<PoseEstimate> estimates;

  std::vector<std::string> ObjectTransitions() const {
    std::vector<std::string> names;
    for (const PhaseTransition& transition : transitions) {
      if (const auto* change = std::get_if<ObjectTransition>(&transition.change)) {
        names.push_back(
            absl::StrCat(std::string(ObjectPhaseName(change->from)), " to ", std::string(ObjectPhaseName(change->to))));
      }
    }
    return names;
  }
};

TrackedStream TrackStream(Tracker& tracker, const std::vector<Event>& events, bool listens = true) {
  TrackedStream run;
  if (listens) {
    tracker.SetPhaseListener([&run](const PhaseTransition& transition) { run.transitions.push_back(transition); });
  }
  tracker.AddEvents(events, run.estimates);
  tracker.Finish(run.estimates);
  return run;
}

template <typename Phase, typename Input, int kNumInputs>
bool IsAllowed(Phase from, Phase to) {
  for (int input = 0; input < kNumInputs; ++input) {
    if (NextPhase(from, static_cast<Input>(input)) == to) return true;
  }
  return false;
}

void ExpectChainOfAllowedTransitions(const TrackedStream& run) {
  ObjectPhase phase = ObjectPhase::kSearching;
  int64_t t_us = 0;
  for (const PhaseTransition& transition : run.transitions) {
    if (const auto* track = std::get_if<TrackTransition>(&transition.change)) {
      EXPECT_TRUE((IsAllowed<TrackPhase, TrackInput, kNumTrackInputs>(track->from, track->to)))
          << TrackPhaseName(track->from) << " to " << TrackPhaseName(track->to);
      continue;
    }
    const auto& object = std::get<ObjectTransition>(transition.change);
    EXPECT_EQ(object.from, phase);
    EXPECT_TRUE((IsAllowed<ObjectPhase, ObjectInput, kNumObjectInputs>(object.from, object.to)))
        << ObjectPhaseName(object.from) << " to " << ObjectPhaseName(object.to);
    EXPECT_GE(transition.t_us, t_us);
    phase = object.to;
    t_us = transition.t_us;
  }
}

TEST(PhaseListenerTest, AnObjectThatJumpsIsLostAndFoundAgain) {
  const auto tracker = MakeTracker();
  const TrackedStream run = TrackStream(*tracker, MakeStream({{80'000, 1.0, 2e4}, {250'000, 1.0, 2e4, true}}));
  ExpectChainOfAllowedTransitions(run);
  EXPECT_THAT(run.ObjectTransitions(), IsSupersetOf({"VERIFYING to PUBLISHED", "PUBLISHED to VERIFYING_COMPETING"}));
  EXPECT_EQ(tracker->losses(), 1u);
  EXPECT_TRUE(tracker->state() == TrackState::kTracking || tracker->state() == TrackState::kDegraded);
}

TEST(PhaseListenerTest, AnObjectAtRestCoasts) {
  const auto tracker = MakeTracker();
  const TrackedStream run =
      TrackStream(*tracker, MakeStream({{80'000, 1.0, 2e4}, {100'000, 0.0, 1e3}, {80'000, 1.0, 2e4}}));
  ExpectChainOfAllowedTransitions(run);
  std::map<std::pair<TrackPhase, TrackPhase>, int> counts;
  for (const PhaseTransition& transition : run.transitions) {
    if (const auto* track = std::get_if<TrackTransition>(&transition.change)) ++counts[{track->from, track->to}];
  }
  EXPECT_GE((counts[{TrackPhase::kTentative, TrackPhase::kConfirmed}]), 1);
  EXPECT_GE((counts[{TrackPhase::kConfirmed, TrackPhase::kCoasting}]), 1);
  EXPECT_EQ(tracker->losses(), 0u);
}

TEST(PhaseListenerTest, AWrongGivenPoseIsRejected) {
  const auto tracker = MakeTracker(MakePose({0.2, 0.1, 0.9}, {0.1, 0.2, 0.3}));
  const TrackedStream run = TrackStream(*tracker, MakeStream({{200'000, 1.0, 2e4}}));
  ExpectChainOfAllowedTransitions(run);
  ASSERT_FALSE(run.ObjectTransitions().empty());
  EXPECT_EQ(run.ObjectTransitions().front(), "SEARCHING to VERIFYING_GIVEN");
  EXPECT_THAT(run.ObjectTransitions(), ::testing::Not(::testing::Contains("VERIFYING_GIVEN to PUBLISHED")));
  // The hypothesis is reported as lost before the object.
  const auto lost = std::find_if(run.transitions.begin(), run.transitions.end(), [](const PhaseTransition& each) {
    const auto* const track = std::get_if<TrackTransition>(&each.change);
    return track != nullptr && track->to == TrackPhase::kLost;
  });
  ASSERT_NE(lost, run.transitions.end());
  EXPECT_EQ(std::get<TrackTransition>(lost->change).from, TrackPhase::kTentative);
  ASSERT_NE(lost + 1, run.transitions.end());
  EXPECT_TRUE(IsGiven(std::get<ObjectTransition>((lost + 1)->change).from));
  EXPECT_EQ((lost + 1)->t_us, lost->t_us);
}

TEST(PhaseListenerTest, EstimatesDoNotDependOnTheListener) {
  const std::vector<Event> events = MakeStream({{80'000, 1.0, 2e4}, {60'000, 0.1, 1e5}, {60'000, 1.0, 2e4}});
  const TrackedStream with = TrackStream(*MakeTracker(), events);
  const TrackedStream without = TrackStream(*MakeTracker(), events, false);
  EXPECT_FALSE(with.transitions.empty());
  ASSERT_EQ(with.estimates.size(), without.estimates.size());
  for (size_t i = 0; i < with.estimates.size(); ++i) {
    EXPECT_EQ(with.estimates[i].camera_from_object.translation_m,
              without.estimates[i].camera_from_object.translation_m);
    EXPECT_EQ(with.estimates[i].covariance, without.estimates[i].covariance);
  }
}

}  // namespace
}  // namespace evpose
