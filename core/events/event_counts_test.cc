// SPDX-License-Identifier: Apache-2.0
#include "core/events/event_counts.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numeric>
#include <vector>

namespace evpose {
namespace {

using ::testing::ElementsAre;

std::vector<Event> EventsAt(const std::vector<int64_t>& times_us) {
  std::vector<Event> events;
  for (const int64_t t_us : times_us) {
    Event event;
    event.t_us = t_us;
    events.push_back(event);
  }
  return events;
}

TEST(EventCountsTest, CountsFromTheFirstEvent) {
  EventCounts counts;
  EXPECT_THAT(counts.counts(), ElementsAre());
  counts.Add(EventsAt({5000, 5001, 6023, 6024}));
  counts.Add(EventsAt({5100, 8100, 4000}));
  EXPECT_EQ(counts.from_us(), 5000);
  EXPECT_EQ(counts.step_us(), 1024);
  EXPECT_THAT(counts.counts(), ElementsAre(5, 1, 0, 1));
}

TEST(EventCountsTest, IntervalsOfALongRecordingAreLonger) {
  EventCounts counts;
  constexpr int64_t kEvents = 3 * static_cast<int64_t>(EventCounts::kMaxIntervals) + 1;
  for (int64_t i = 0; i < kEvents; ++i) counts.Add(EventsAt({7 + i * EventCounts::kFirstStepUs}));
  EXPECT_EQ(counts.step_us(), 4 * EventCounts::kFirstStepUs);
  ASSERT_EQ(counts.counts().size(), static_cast<size_t>((kEvents + 3) / 4));
  for (size_t i = 0; i + 1 < counts.counts().size(); ++i) EXPECT_EQ(counts.counts()[i], 4u) << i;
  EXPECT_EQ(counts.counts().back(), 1u);
}

TEST(EventCountsTest, AJumpOfTheClockNeedsNoMemory) {
  EventCounts counts;
  counts.Add(EventsAt({0, 1'000, 5'000, int64_t{1} << 62}));
  EXPECT_LE(counts.counts().size(), EventCounts::kMaxIntervals);
  EXPECT_EQ(std::accumulate(counts.counts().begin(), counts.counts().end(), uint64_t{0}), 4u);
  EXPECT_EQ(counts.counts().front(), 3u);
}

}  // namespace
}  // namespace evpose
