// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/object/rival_schedule.h"

#include <gtest/gtest.h>

#include <string>

#include "core/tracking/object/saved_state_testing.h"

namespace evpose {
namespace {

InitializationOptions RivalOptions() {
  InitializationOptions options;
  options.rival_interval_us = 1000;
  options.num_rival_rounds = 2;
  return options;
}

void ExpectGroup(const RivalSchedule::Group& group, int begin, int end, RivalPrior prior) {
  EXPECT_EQ(group.begin, begin);
  EXPECT_EQ(group.end, end);
  EXPECT_EQ(group.prior, prior);
}

TEST(RivalScheduleTest, NothingIsDueBeforeAPoseIsPublished) {
  const InitializationOptions options = RivalOptions();
  RivalSchedule schedule(options);
  EXPECT_FALSE(schedule.IsDue(1'000'000));
  schedule.StartRounds(500, RivalPrior::kEqual);
  EXPECT_FALSE(schedule.IsDue(499));
  EXPECT_TRUE(schedule.IsDue(500));
}

TEST(RivalScheduleTest, ARoundHasGroupsOfThreeAndTheNextOneFollowsAfterTheInterval) {
  const InitializationOptions options = RivalOptions();
  RivalSchedule schedule(options);
  schedule.StartRounds(0, RivalPrior::kEqual);
  ExpectGroup(schedule.NextGroup(10, 7), 0, 3, RivalPrior::kEqual);
  EXPECT_TRUE(schedule.IsDue(10)) << "within the round";
  ExpectGroup(schedule.NextGroup(20, 7), 3, 6, RivalPrior::kEqual);
  ExpectGroup(schedule.NextGroup(30, 7), 6, 7, RivalPrior::kEqual);
  EXPECT_FALSE(schedule.IsDue(1029));
  ASSERT_TRUE(schedule.IsDue(1030));
  ExpectGroup(schedule.NextGroup(1040, 3), 0, 3, RivalPrior::kUnlikely);
  EXPECT_FALSE(schedule.IsDue(1'000'000)) << "after the last round";
}

TEST(RivalScheduleTest, ARoundWithoutRivalsEndsAtOnce) {
  const InitializationOptions options = RivalOptions();
  RivalSchedule schedule(options);
  schedule.StartRounds(0, RivalPrior::kEqual);
  ExpectGroup(schedule.NextGroup(10, 0), 0, 0, RivalPrior::kEqual);
  EXPECT_FALSE(schedule.IsDue(1009));
  EXPECT_TRUE(schedule.IsDue(1010));
}

TEST(RivalScheduleTest, ARoundWhoseRivalsHaveBecomeFewerEnds) {
  const InitializationOptions options = RivalOptions();
  RivalSchedule schedule(options);
  schedule.StartRounds(0, RivalPrior::kEqual);
  schedule.NextGroup(10, 7);
  ExpectGroup(schedule.NextGroup(20, 2), 3, 3, RivalPrior::kEqual);
  EXPECT_FALSE(schedule.IsDue(1019));
  EXPECT_TRUE(schedule.IsDue(1020));
}

TEST(RivalScheduleTest, AnotherPublishedPoseStartsItsRoundsAnew) {
  const InitializationOptions options = RivalOptions();
  RivalSchedule schedule(options);
  schedule.StartRounds(0, RivalPrior::kEqual);
  schedule.NextGroup(10, 3);
  schedule.NextGroup(1020, 7);
  schedule.StartRounds(1030, RivalPrior::kEqual);
  ASSERT_TRUE(schedule.IsDue(1030));
  ExpectGroup(schedule.NextGroup(1030, 3), 0, 3, RivalPrior::kEqual);
  ASSERT_TRUE(schedule.IsDue(2030)) << "all rounds are left";
  schedule.StartRounds(2040, RivalPrior::kUnlikely);
  ExpectGroup(schedule.NextGroup(2040, 1), 0, 1, RivalPrior::kUnlikely);
}

TEST(RivalScheduleTest, IsSavedAsTimeRoundsNextRivalAndPrior) {
  const InitializationOptions options = RivalOptions();
  RivalSchedule schedule(options), loaded(options);
  schedule.StartRounds(500, RivalPrior::kUnlikely);
  schedule.NextGroup(500, 7);
  const std::string bytes = Saved(schedule);
  EXPECT_EQ(bytes, Saved(int64_t{500}, int32_t{2}, int32_t{3}, int32_t{1}));
  ASSERT_TRUE(IsRestored(bytes, loaded));
  EXPECT_EQ(Saved(loaded), bytes);
}

TEST(RivalScheduleTest, RefusesAStateThatCannotBeSaved) {
  const InitializationOptions options = RivalOptions();
  const auto is_read = [&](int64_t next_us, int32_t rounds, int32_t next_rival, int32_t prior) {
    RivalSchedule schedule(options);
    return IsRestored(Saved(next_us, rounds, next_rival, prior), schedule);
  };
  EXPECT_TRUE(is_read(kMaxStateTimeUs, 2, RivalGenerator::kMaxRivals, 1));
  EXPECT_FALSE(is_read(kMaxStateTimeUs + 1, 0, 0, 0));
  EXPECT_FALSE(is_read(-kMaxStateTimeUs - 1, 0, 0, 0));
  EXPECT_FALSE(is_read(0, 3, 0, 0)) << "more than num_rival_rounds";
  EXPECT_FALSE(is_read(0, -1, 0, 0));
  EXPECT_FALSE(is_read(0, 0, RivalGenerator::kMaxRivals + 1, 0));
  EXPECT_FALSE(is_read(0, 0, -1, 0));
  EXPECT_FALSE(is_read(0, 0, 0, 2));
}

}  // namespace
}  // namespace evpose
