// SPDX-License-Identifier: Apache-2.0
#include "server/scheduling/arrival_monitor.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cstdint>

namespace evpose::server {
namespace {

using std::chrono::milliseconds;

constexpr ArrivalMonitor::Time kStart{std::chrono::hours(1)};

class ArrivalMonitorTest : public testing::Test {
 protected:
  // Items of 10 ms of sensor time between these times; the sensor time `begin_ms` is received at `received_ms`.
  void Process(int begin_ms, int end_ms, int received_ms, double rate, bool is_drained) {
    for (int ms = begin_ms; ms < end_ms; ms += 10) {
      const milliseconds after(received_ms + static_cast<int>((ms - begin_ms) / rate));
      monitor_.Update(kStart + after, int64_t{1000} * ms, is_drained);
    }
  }

  ArrivalMonitor monitor_;
};

TEST(RestoredArrivalMonitorTest, ACameraIsLiveAfterItsServerWasLost) {
  ArrivalMonitor monitor(std::chrono::seconds(10));
  monitor.Update(kStart, 0, false);
  monitor.Update(kStart + milliseconds(20), 9'900'000, false);
  EXPECT_EQ(monitor.arrival(), Arrival::kLive);
  monitor.Update(kStart + milliseconds(40), 10'200'000, false);
  EXPECT_EQ(monitor.arrival(), Arrival::kBulk) << "a replay is recognized after the time that a client may have kept";
}

TEST_F(ArrivalMonitorTest, AReplayAtFullSpeedIsNotLive) {
  Process(0, 50, 0, 1000.0, false);
  EXPECT_EQ(monitor_.arrival(), Arrival::kLive) << "a network may deliver 50 ms at once";
  Process(50, 200, 0, 1000.0, false);
  EXPECT_EQ(monitor_.arrival(), Arrival::kBulk);
  Process(200, 10'000, 0, 0.5, false);
  EXPECT_EQ(monitor_.arrival(), Arrival::kBulk) << "it has not become a camera by being processed slowly";
}

TEST_F(ArrivalMonitorTest, ACameraIsLiveHoweverMuchOfItWaits) {
  Process(0, 10'000, 0, 1.0, false);
  EXPECT_EQ(monitor_.arrival(), Arrival::kLive);
}

TEST_F(ArrivalMonitorTest, ACameraIsLiveAfterItsClientWasAway) {
  Process(0, 1000, 0, 1.0, true);
  Process(1000, 6000, 6000, 1000.0, false);  // what the client has kept arrives at once
  EXPECT_EQ(monitor_.arrival(), Arrival::kLive);
}

TEST_F(ArrivalMonitorTest, ACameraWhoseFirstItemWasLateIsLive) {
  Process(0, 10, 300, 1.0, true);  // while the session was created
  Process(10, 310, 301, 1000.0, false);
  EXPECT_EQ(monitor_.arrival(), Arrival::kBulk) << "it has caught up as a replay does";
  Process(310, 320, 310, 1.0, true);
  EXPECT_EQ(monitor_.arrival(), Arrival::kLive);
  Process(320, 5000, 320, 1.0, false);
  EXPECT_EQ(monitor_.arrival(), Arrival::kLive);
}

TEST_F(ArrivalMonitorTest, AFastClockOfTheSensorIsFollowed) {
  Process(0, 1'000'000, 0, 1.001, true);
  Process(1'000'000, 1'010'000, 999'000, 1.001, false);
  EXPECT_EQ(monitor_.arrival(), Arrival::kLive);
}

TEST_F(ArrivalMonitorTest, ADrainedSessionIsComparedFromThereOn) {
  Process(0, 1000, 0, 100.0, false);
  ASSERT_EQ(monitor_.arrival(), Arrival::kBulk);
  Process(1000, 1010, 20, 1.0, true);
  EXPECT_EQ(monitor_.arrival(), Arrival::kLive);
  Process(1010, 5000, 30, 1.0, false);
  EXPECT_EQ(monitor_.arrival(), Arrival::kLive);
  Process(5000, 6000, 4020, 100.0, false);
  EXPECT_EQ(monitor_.arrival(), Arrival::kBulk);
}

}  // namespace
}  // namespace evpose::server
