// SPDX-License-Identifier: Apache-2.0

// Tracking with gaps: events that are discarded by Skip().
#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "core/estimation/ideal_events_testing.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using testing::IdealEventOptions;
using testing::MakeCube;
using testing::MakeIdealEvents;
using testing::Motion;

Motion Moving(double speed_m_per_s) {
  Vector6d twist;
  twist << speed_m_per_s, 0.3 * speed_m_per_s, 0.0, 0.5, 0.0, 0.5;
  return ConstantTwist(kStart, twist);
}

std::vector<Event> CubeEvents(const Motion& motion, int64_t duration_us, uint64_t seed = 1) {
  return EventsOf(*MakeCube(0.15), motion, 0, duration_us, seed);
}

struct SkipRun {
  std::unique_ptr<Tracker> tracker;
  std::vector<PoseEstimate> before, after;
  EventGap gap;
};

// Discards the events from `skip_from_us` to `skip_to_us`.
SkipRun TrackWithSkip(const std::vector<Event>& events, int64_t skip_from_us, int64_t skip_to_us) {
  SkipRun run;
  run.tracker = Tracker::Create(MakeCube(0.15), kCamera, WithoutInitialization(), kStart).value();
  const auto at = [&events](int64_t t_us) {
    const auto is_earlier = [](const Event& event, int64_t limit_us) { return event.t_us < limit_us; };
    return static_cast<size_t>(std::lower_bound(events.begin(), events.end(), t_us, is_earlier) - events.begin());
  };
  const absl::Span<const Event> all = events;
  const size_t from = at(skip_from_us), to = at(skip_to_us);
  run.tracker->AddEvents(all.subspan(0, from), run.before);
  run.gap = run.tracker->Skip(all.subspan(from, to - from), skip_to_us);
  run.tracker->AddEvents(all.subspan(to), run.after);
  run.tracker->Finish(run.after);
  return run;
}

double PositionError(const PoseEstimate& estimate, const Motion& motion) {
  return (estimate.camera_from_object.translation_m - motion(1e-6 * static_cast<double>(estimate.t_us)).translation_m)
      .norm();
}

TEST(TrackerSkip, BridgesAGapWithAnUncertaintyThatHasGrown) {
  const Motion motion = Moving(0.3);
  double nees = 0.0;
  for (uint64_t seed = 1; seed <= 8; ++seed) {
    const std::vector<Event> events = CubeEvents(motion, 200'000, seed);
    const SkipRun run = TrackWithSkip(events, 100'000, 130'000);
    EXPECT_EQ(run.tracker->state(), TrackState::kTracking);
    EXPECT_EQ(run.tracker->losses(), 0u);
    ASSERT_GT(run.before.size(), 20u);
    ASSERT_GT(run.after.size(), 20u);
    EXPECT_LE(run.before.back().t_us, run.gap.t_begin_us);
    EXPECT_EQ(run.gap.t_end_us, 130'000);
    EXPECT_GE(run.after.front().t_us, run.gap.t_end_us);
    EXPECT_LT(run.after.front().t_us, run.gap.t_end_us + 5000);

    const auto translation_variance = [](const PoseEstimate& estimate) {
      return estimate.covariance.topLeftCorner<3, 3>().trace();
    };
    EXPECT_GT(translation_variance(run.after.front()), 1.5 * translation_variance(run.before.back()));
    EXPECT_LT(PositionError(run.after.back(), motion), 1e-3);
    Vector6d error =
        Difference(motion(1e-6 * static_cast<double>(run.after.front().t_us)), run.after.front().camera_from_object);
    nees += error.dot(run.after.front().covariance.ldlt().solve(error)) / 8.0;
  }
  EXPECT_LT(nees, 4.0 * 6.0);
}

TEST(TrackerSkip, AGapIsNotTreatedAsRest) {
  const Motion motion = Moving(0.5);
  const std::vector<Event> events = CubeEvents(motion, 200'000);
  const SkipRun run = TrackWithSkip(events, 100'000, 110'000);
  // After AdvanceTime() instead of Skip() the tracker concludes that the object was at rest and reports its pose.
  const auto in_gap = [](const PoseEstimate& estimate) { return estimate.t_us > 100'000 && estimate.t_us < 110'000; };
  EXPECT_TRUE(std::none_of(run.before.begin(), run.before.end(), in_gap));
  EXPECT_TRUE(std::none_of(run.after.begin(), run.after.end(), in_gap));
  for (const PoseEstimate& estimate : run.after) {
    EXPECT_EQ(estimate.state, TrackState::kTracking) << estimate.t_us;
    EXPECT_LT(PositionError(estimate, motion), 2e-3) << estimate.t_us;
    EXPECT_NEAR(estimate.twist[0], 0.5, 0.1) << estimate.t_us;
  }
}

TEST(TrackerSkip, TheGivenPoseIsThatOfTheFirstEventAlsoWhenItIsSkipped) {
  const Motion motion = Moving(0.3);
  const SkipRun run = TrackWithSkip(CubeEvents(motion, 150'000), 0, 10'000);
  EXPECT_TRUE(run.before.empty());
  EXPECT_EQ(run.tracker->state(), TrackState::kTracking);
  ASSERT_FALSE(run.after.empty());
  for (const PoseEstimate& estimate : run.after) EXPECT_LT(PositionError(estimate, motion), 3e-3) << estimate.t_us;
}

TEST(TrackerSkip, AfterALongGapThePoseIsLostAndNotGuessed) {
  const Motion motion = Moving(0.3);
  std::vector<Event> events = CubeEvents(motion, 100'000);
  IdealEventOptions later;
  later.t_begin_us = 5'000'000;
  later.duration_us = 100'000;
  const Motion elsewhere = [&motion](double t_s) {
    RigidTransform pose = motion(t_s - 5.0);
    pose.translation_m.y() += 0.05;
    return pose;
  };
  for (const Event& event : MakeIdealEvents(*MakeCube(0.15), kCamera, elsewhere, later)) events.push_back(event);
  const SkipRun run = TrackWithSkip(events, 100'000, 5'000'000);
  EXPECT_EQ(run.tracker->state(), TrackState::kLost);
  EXPECT_EQ(run.tracker->losses(), 1u);
  EXPECT_TRUE(run.after.empty());
}

}  // namespace
}  // namespace evpose
