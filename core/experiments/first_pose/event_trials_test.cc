// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/event_trials.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace evpose {
namespace {

using ::testing::HasSubstr;

constexpr SimulatedObject kObjects[] = {SimulatedObject::kCube, SimulatedObject::kCuboid, SimulatedObject::kPlanar,
                                        SimulatedObject::kBook, SimulatedObject::kSpacecraft};

EventTrialOptions Short(SimulatedObject object = SimulatedObject::kCube) {
  EventTrialOptions options;
  options.object = object;
  options.num_starts = 8;
  options.recording_us = 600'000;
  return options;
}

// Options for tests that do not depend on the poses.
EventTrialOptions Tiny() {
  EventTrialOptions options = Short();
  options.camera = "vga";
  options.num_starts = 2;
  options.recording_us = 200'000;
  options.watch_us = 100'000;
  return options;
}

class EventTrialsTest : public testing::TestWithParam<SimulatedObject> {};

TEST_P(EventTrialsTest, FirstPosesAreRightSoonAndNeverWrong) {
  const auto trials = RunEventTrials(Short(GetParam()));
  ASSERT_TRUE(trials.ok()) << trials.status();
  const EventTrialSummary summary = Summarize(*trials);
  EXPECT_EQ(summary.num_starts, 8);
  EXPECT_GE(summary.num_right, 7);
  EXPECT_EQ(summary.num_wrong, 0);
  EXPECT_EQ(summary.longest_wrong_us, 0);
  EXPECT_LT(summary.first_pose_median_ms, 50.0);
  EXPECT_GT(summary.first_pose_median_ms, 1.0);
  EXPECT_LT(summary.reprojection_mean_px, 1.8);
}

INSTANTIATE_TEST_SUITE_P(Objects, EventTrialsTest, testing::ValuesIn(kObjects),
                         [](const auto& test) { return std::string(SimulatedObjectName(test.param)); });

class ReturnTrialTest : public testing::TestWithParam<SimulatedObject> {};

TEST_P(ReturnTrialTest, IsTrackedAgainWithinATenthOfASecond) {
  EventTrialOptions options = Short(GetParam());
  options.watch_us = 120'000;
  const auto trial = RunReturnTrial(options, 1'000'000);
  ASSERT_TRUE(trial.ok()) << trial.status();
  EXPECT_TRUE(trial->was_tracked);
  EXPECT_GT(trial->tracked_us, 0);
  EXPECT_LE(trial->tracked_us, 100'000);
  EXPECT_EQ(trial->wrong_us, 0);
  EXPECT_LE(trial->lingering_us, 100'000);
}

INSTANTIATE_TEST_SUITE_P(Objects, ReturnTrialTest,
                         testing::Values(SimulatedObject::kCube, SimulatedObject::kBook, SimulatedObject::kSpacecraft),
                         [](const auto& test) { return std::string(SimulatedObjectName(test.param)); });

TEST(EventTrials, AreAFunctionOfTheOptions) {
  const auto a = RunEventTrials(Tiny());
  const auto b = RunEventTrials(Tiny());
  EventTrialOptions other = Tiny();
  other.seed = 2;
  const auto c = RunEventTrials(other);
  ASSERT_TRUE(a.ok() && b.ok() && c.ok());
  ASSERT_EQ(a->size(), 2u);
  for (size_t i = 0; i < a->size(); ++i) {
    EXPECT_EQ((*a)[i].t_start_us, (*b)[i].t_start_us);
    EXPECT_EQ((*a)[i].t_first_pose_us, (*b)[i].t_first_pose_us);
    EXPECT_EQ((*a)[i].reprojection_px, (*b)[i].reprojection_px);
    EXPECT_NE((*a)[i].t_start_us, (*c)[i].t_start_us);
  }
}

TEST(EventTrials, TheDetectorChangesWhatIsFound) {
  EventTrialOptions options = Tiny();
  const auto planes = RunEventTrials(options);
  options.detector = "lsd";
  const auto lsd = RunEventTrials(options);
  ASSERT_TRUE(planes.ok() && lsd.ok());
  ASSERT_EQ(lsd->size(), planes->size());
  for (size_t i = 0; i < lsd->size(); ++i) {
    EXPECT_EQ((*lsd)[i].t_start_us, (*planes)[i].t_start_us);
    EXPECT_GT((*lsd)[i].attempts, 0u);
    EXPECT_NE((*lsd)[i].reprojection_px, (*planes)[i].reprojection_px);
  }
}

TEST(EventTrials, ProgressRisesAndEndsTheWork) {
  double last = 0.0;
  const auto all = RunEventTrials(Tiny(), [&](double ratio) {
    EXPECT_GE(ratio, last);
    last = ratio;
    return true;
  });
  ASSERT_TRUE(all.ok()) << all.status();
  EXPECT_EQ(last, 1.0);
  const auto stopped = RunEventTrials(Tiny(), [](double) { return false; });
  EXPECT_EQ(stopped.status().code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(RunReturnTrial(Tiny(), 1000, [](double) { return false; }).status().code(), absl::StatusCode::kCancelled);
}

TEST(EventTrials, OptionsAreChecked) {
  const auto message = [](const auto& change) {
    EventTrialOptions options = Tiny();
    change(options);
    const auto trials = RunEventTrials(options);
    EXPECT_EQ(trials.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_EQ(RunReturnTrial(options, 1000).status().code(), absl::StatusCode::kInvalidArgument);
    return std::string(trials.status().message());
  };
  EXPECT_THAT(message([](auto& o) { o.num_starts = 0; }), HasSubstr("num_starts"));
  EXPECT_THAT(message([](auto& o) { o.noise_ratio = -0.1; }), HasSubstr("noise_ratio"));
  EXPECT_THAT(message([](auto& o) { o.watch_us = 300'000; }), HasSubstr("recording_us"));
  EXPECT_THAT(message([](auto& o) { o.camera = "mp4"; }), HasSubstr("evk4"));
  EXPECT_THAT(message([](auto& o) { o.detector = "hough"; }), HasSubstr("planes, lsd"));
  EXPECT_THAT(message([](auto& o) { o.tracker.initialization.min_events = -1; }), HasSubstr("min_events"));
  EXPECT_EQ(RunReturnTrial(Tiny(), -1).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(EventTrialSummary, ComputesCountsMediansAndMaxima) {
  const std::vector<EventTrial> trials = {{0, 20'000, true, 1.0, 0, 1},
                                          {0, 50'000, true, 2.0, 5'000, 2},
                                          {0, 60'000, true, 3.0, 0, 3},
                                          {0, 10'000, false, 90.0, 7'000, 1},
                                          {0, -1, false, 0.0, 0, 9}};
  const EventTrialSummary summary = Summarize(trials);
  EXPECT_EQ(summary.num_starts, 5);
  EXPECT_EQ(summary.num_right, 2);
  EXPECT_EQ(summary.num_wrong, 1);
  EXPECT_EQ(summary.num_none, 1);
  EXPECT_EQ(summary.first_pose_median_ms, 50.0);
  EXPECT_EQ(summary.reprojection_mean_px, 2.0);
  EXPECT_EQ(summary.longest_wrong_us, 7'000);
  EXPECT_TRUE(std::isnan(Summarize({}).first_pose_median_ms));
  EXPECT_TRUE(std::isnan(Summarize({}).reprojection_mean_px));
}

}  // namespace
}  // namespace evpose
