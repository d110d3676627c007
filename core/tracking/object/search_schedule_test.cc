// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/search_schedule.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "core/tracking/object/saved_state_testing.h"

namespace evpose {
namespace {

InitializationOptions SearchOptions() {
  InitializationOptions options;
  options.retry_us = 4000;
  options.max_retry_us = 8000;
  options.max_no_pose_retry_us = 12'000;
  options.repeat_us = 5000;
  options.num_repeats = 2;
  return options;
}

// The time from `t_us` until the next search is due.
int64_t Wait(const SearchSchedule& schedule, int64_t t_us) {
  int64_t wait_us = 0;
  while (!schedule.IsDue(t_us + wait_us)) ++wait_us;
  return wait_us;
}

TEST(SearchScheduleTest, TheFirstSearchIsDueAtOnce) {
  const InitializationOptions options = SearchOptions();
  EXPECT_TRUE(SearchSchedule(options).IsDue(0));
  EXPECT_FALSE(SearchSchedule(options).has_repeats());
}

TEST(SearchScheduleTest, PostponesByTheFirstIntervalAlone) {
  const InitializationOptions options = SearchOptions();
  SearchSchedule schedule(options);
  for (const int64_t t_us : {100, 300}) {
    schedule.Postpone(t_us);
    EXPECT_EQ(Wait(schedule, t_us), 4000);
  }
  schedule.OnSearch(1000, false);
  EXPECT_EQ(Wait(schedule, 1000), 5001) << "the interval has not grown before";
}

TEST(SearchScheduleTest, TheIntervalGrowsByAQuarterUpToItsLongestOne) {
  const InitializationOptions options = SearchOptions();
  for (const bool has_moved_edges : {false, true}) {
    SearchSchedule schedule(options);
    std::vector<int64_t> waits_us;
    for (int64_t t_us = 0; t_us < 600; t_us += 100) {
      schedule.OnSearch(t_us, has_moved_edges);
      waits_us.push_back(Wait(schedule, t_us));
    }
    const std::vector<int64_t> expected = has_moved_edges ? std::vector<int64_t>{5001, 6252, 7816, 9771, 12'000, 12'000}
                                                          : std::vector<int64_t>{5001, 6252, 7816, 8000, 8000, 8000};
    EXPECT_EQ(waits_us, expected);
  }
}

TEST(SearchScheduleTest, RepeatsTheSearchAfterThePublicationOfAFoundPose) {
  const InitializationOptions options = SearchOptions();
  SearchSchedule schedule(options);
  schedule.OnPublication(1000, false);
  EXPECT_EQ(Wait(schedule, 1000), 5000);
  for (const bool has_another : {true, false}) {
    EXPECT_TRUE(schedule.has_repeats());
    schedule.OnSearchBesideHypotheses(6000, true);
    EXPECT_EQ(schedule.has_repeats(), has_another);
    EXPECT_EQ(Wait(schedule, 6000), 5000);
  }
}

TEST(SearchScheduleTest, AGivenPoseNeedsNoRepeatedSearch) {
  const InitializationOptions options = SearchOptions();
  SearchSchedule schedule(options);
  schedule.OnPublication(0, false);
  schedule.OnPublication(1000, true);
  EXPECT_FALSE(schedule.has_repeats());
  EXPECT_EQ(Wait(schedule, 1000), 5000);
}

TEST(SearchScheduleTest, TheIntervalOfADoubtfulPoseGrowsByHalfUntilItIsTrackingOrLost) {
  const InitializationOptions options = SearchOptions();
  SearchSchedule schedule(options);
  schedule.OnPublication(0, true);
  for (const int64_t wait_us : {5000, 7500, 8000, 8000}) {
    schedule.OnSearchBesideHypotheses(1000, true);
    EXPECT_EQ(Wait(schedule, 1000), wait_us);
  }
  schedule.OnTracking();
  schedule.OnSearchBesideHypotheses(1000, true);
  EXPECT_EQ(Wait(schedule, 1000), 5000);
  schedule.OnLoss();
  schedule.OnSearch(1000, false);
  EXPECT_EQ(Wait(schedule, 1000), 5001) << "a quarter longer than the first interval";
}

TEST(SearchScheduleTest, SearchesBesideUnpublishedHypothesesAtConstantIntervals) {
  const InitializationOptions options = SearchOptions();
  SearchSchedule schedule(options);
  for (int i = 0; i < 3; ++i) {
    schedule.OnSearchBesideHypotheses(1000, false);
    EXPECT_EQ(Wait(schedule, 1000), 5000);
  }
  schedule.OnSearch(1000, false);
  EXPECT_EQ(Wait(schedule, 1000), 5001) << "the interval of searches without hypotheses has not grown";
}

TEST(SearchScheduleTest, IsSavedAsTimeIntervalAndRepeats) {
  const InitializationOptions options = SearchOptions();
  SearchSchedule schedule(options), loaded(options);
  schedule.OnPublication(1000, false);
  const std::string bytes = Saved(schedule);
  EXPECT_EQ(bytes, Saved(int64_t{6000}, int64_t{5000}, int32_t{2}));
  ASSERT_TRUE(IsRestored(bytes, loaded));
  EXPECT_EQ(Saved(loaded), bytes);
}

TEST(SearchScheduleTest, RefusesAStateThatCannotBeSaved) {
  const InitializationOptions options = SearchOptions();
  const auto is_read = [&](int64_t next_us, int64_t interval_us, int32_t repeats) {
    SearchSchedule schedule(options);
    return IsRestored(Saved(next_us, interval_us, repeats), schedule);
  };
  EXPECT_TRUE(is_read(-kMaxStateTimeUs, 0, 0));
  EXPECT_FALSE(is_read(-kMaxStateTimeUs - 1, 0, 0));
  EXPECT_FALSE(is_read(kMaxStateTimeUs + 1, 0, 0));
  EXPECT_FALSE(is_read(0, -1, 0));
  EXPECT_FALSE(is_read(0, kMaxStateTimeUs + 1, 0));
  EXPECT_FALSE(is_read(0, 0, -1));
  EXPECT_FALSE(is_read(0, 0, 3)) << "more than num_repeats";
}

}  // namespace
}  // namespace evpose
