// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/event_feed.h"

#include <gtest/gtest.h>

#include <memory>
#include <vector>

#include "client/lib/fake_clock_testing.h"
#include "client/lib/stream/due_times.h"

namespace evpose::client {
namespace {

constexpr absl::Time kBegin = absl::UnixEpoch();

TEST(DueTimesTest, TheOldestUnprocessedPieceHasTheLag) {
  DueTimes times;
  EXPECT_EQ(times.Lag(0, kBegin), absl::ZeroDuration());
  times.Add(1, kBegin);
  times.Add(2, kBegin + absl::Milliseconds(500));
  times.Add(4, kBegin + absl::Seconds(2));
  const absl::Time now = kBegin + absl::Seconds(1);
  EXPECT_EQ(times.Lag(0, now), absl::Seconds(1));
  EXPECT_EQ(times.Lag(1, now), absl::Milliseconds(500));
  EXPECT_EQ(times.Lag(3, now), absl::ZeroDuration()) << "piece 4 is due later";
  EXPECT_EQ(times.Lag(4, now + absl::Hours(1)), absl::ZeroDuration());
}

TEST(DueTimesTest, PiecesWithinAStepShareTheTimeOfTheFirst) {
  DueTimes times;
  times.Add(1, kBegin);
  times.Add(2, kBegin + DueTimes::kStep / 2);
  times.Add(3, kBegin + DueTimes::kStep);
  const absl::Time now = kBegin + absl::Seconds(1);
  EXPECT_EQ(times.Lag(1, now), absl::Seconds(1));
  EXPECT_EQ(times.Lag(2, now), absl::Seconds(1) - DueTimes::kStep);
}

// A feed of chunks with these sensor times, microseconds, without delays of the source.
class EventFeedLagTest : public ::testing::Test {
 protected:
  void Read(std::vector<int64_t> times_us, FeedOptions options) {
    options.clock = &clock_;
    const size_t num_chunks = times_us.size();
    auto next = std::make_shared<size_t>(0);
    absl::StatusOr<std::unique_ptr<EventFeed>> feed = EventFeed::Open(
        [next, times_us = std::move(times_us)]() -> absl::StatusOr<EventChunk> {
          if (*next == times_us.size()) return EventChunk{};
          return EventChunk{.bytes = std::vector<uint8_t>(8), .t_last_us = times_us[(*next)++]};
        },
        options);
    ASSERT_TRUE(feed.ok()) << feed.status();
    feed_ = *std::move(feed);
    feed_->Start(1 << 20);
    // The chunk after the last one is available when all have been read.
    ASSERT_TRUE(feed_->outbox().Get(num_chunks + 1, {}).ok());
  }

  FakeClock clock_;
  std::unique_ptr<EventFeed> feed_;
};

TEST_F(EventFeedLagTest, ALiveSourceIsDueWhenItIsRead) {
  Read({1'000'000}, {.is_live = true});
  EXPECT_EQ(feed_->Lag(0), absl::ZeroDuration());
  clock_.Advance(absl::Seconds(3));
  EXPECT_EQ(feed_->Lag(0), absl::Seconds(3));
  EXPECT_EQ(feed_->Lag(1), absl::ZeroDuration());
}

TEST_F(EventFeedLagTest, ASourceFasterThanTheSensorIsDueAtTheSensorsPace) {
  Read({1'000'000, 11'000'000}, {.is_live = true});
  clock_.Advance(absl::Seconds(9));
  EXPECT_EQ(feed_->Lag(1), absl::ZeroDuration());
  clock_.Advance(absl::Seconds(3));
  EXPECT_EQ(feed_->Lag(1), absl::Seconds(2));
}

TEST_F(EventFeedLagTest, ARateIsTheScheduleOfTheEvents) {
  Read({0, 1'000'000}, {.rate = 2.0});  // the clock advances by the half second of the wait
  clock_.Advance(absl::Seconds(3));
  EXPECT_EQ(feed_->Lag(0), absl::Milliseconds(3'500));
  EXPECT_EQ(feed_->Lag(1), absl::Seconds(3));
}

TEST_F(EventFeedLagTest, AStepBackOfTheSensorsClockIsNoLag) {
  Read({10'000'000, 12'000'000, 1'000'000}, {.rate = 1.0});
  EXPECT_EQ(feed_->Lag(2), absl::ZeroDuration());
}

TEST_F(EventFeedLagTest, EventsWithoutTimeOrPaceHaveNoLag) {
  Read({-1, -1}, {.is_live = true});
  clock_.Advance(absl::Seconds(3));
  EXPECT_EQ(feed_->Lag(0), absl::ZeroDuration());
  Read({0, 1'000'000}, {});
  clock_.Advance(absl::Seconds(3));
  EXPECT_EQ(feed_->Lag(0), absl::ZeroDuration());
}

}  // namespace
}  // namespace evpose::client
