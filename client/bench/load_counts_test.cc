// SPDX-License-Identifier: Apache-2.0
#include "client/bench/load_counts.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose::client {
namespace {

TEST(LoadCountsTest, AWindowIsDueWithTheChunkAfterItsEnd) {
  // The window of the first pose ends at 10 ms. An event at 10 ms is in the chunk from 10 to 11 ms.
  EXPECT_EQ(WindowDueUs(5'000, 15'000, 1'000), 11'000);
  EXPECT_EQ(WindowDueUs(5'000, 14'998, 1'000), 10'000);
  EXPECT_EQ(WindowDueUs(5'000, 15'000, 20'000), 20'000);
}

TEST(LoadCountsTest, PercentilesAreThoseOfAllUsers) {
  LoadCounts fast, slow, sum;
  for (int i = 0; i < 180; ++i) fast.AddLatency(1'000);
  for (int i = 0; i < 15; ++i) slow.AddLatency(20'000);
  for (int i = 0; i < 5; ++i) slow.AddLatency(300'000);
  sum.Add(fast);
  sum.Add(slow);
  // The buckets are 5 % wide.
  EXPECT_NEAR(static_cast<double>(sum.latency.Percentile(0.5)), 1e3, 50.0);
  EXPECT_NEAR(static_cast<double>(sum.latency.Percentile(0.95)), 2e4, 1e3);
  EXPECT_NEAR(static_cast<double>(sum.latency.Percentile(0.99)), 3e5, 15e3);
  EXPECT_EQ(sum.max_latency_us, 300'000);
}

TEST(LoadCountsTest, PausesAreThoseOfAllSessionsOrOfThoseThatHaveReconnected) {
  const LoadCounts first = {.pauses = {{.longest_us = 3'000'000, .has_reconnected = true}, {.longest_us = 20'000}}};
  const LoadCounts second = {.pauses = {{.longest_us = 1'500'000, .has_reconnected = true}}};
  LoadCounts sum;
  sum.Add(first);
  sum.Add(second);
  EXPECT_THAT(sum.SortedPausesS(false), testing::ElementsAre(0.02, 1.5, 3.0));
  EXPECT_THAT(sum.SortedPausesS(true), testing::ElementsAre(1.5, 3.0));
}

TEST(LoadCountsTest, EventsAndPosesAreThoseOfTheTestAndLossesThoseOfTheRun) {
  const LoadCounts begin = {.events = 1'000, .poses = 10, .watched_poses = 3, .unwatched_poses = 1};
  const LoadCounts end = {.events = 5'000, .poses = 50, .lost_poses = 2, .watched_poses = 23, .unwatched_poses = 8};
  LoadCounts run = {.events = 6'000, .poses = 60, .lost_poses = 4, .watched_poses = 30, .unwatched_poses = 9};
  run.LimitTo(begin, end);
  EXPECT_EQ(run.events, 4'000u);
  EXPECT_EQ(run.poses, 40u);
  EXPECT_EQ(run.lost_poses, 4u);
  EXPECT_EQ(run.watched_poses, 20u);
  EXPECT_EQ(run.unwatched_poses, 7u);
}

}  // namespace
}  // namespace evpose::client
