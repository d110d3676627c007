// SPDX-License-Identifier: Apache-2.0
#include "server/scheduling/pace_monitor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <optional>
#include <vector>

namespace evpose::server {
namespace {

using std::chrono::milliseconds;

// Data arrive at the times of the sensor's clock, times `send_rate`, and are processed at `process_rate`. Returns the
// values of is_behind() at its changes within ten seconds.
std::vector<bool> Changes(double send_rate, double process_rate) {
  PaceMonitor monitor;
  std::vector<bool> changes;
  const PaceMonitor::Time start{std::chrono::hours(1)};
  for (int ms = 0; ms < 10'000; ms += 10) {
    const double sent_ms = send_rate * ms;
    const double processed_ms = std::min(sent_ms, process_rate * ms);
    std::optional<PaceMonitor::Time> oldest;
    if (processed_ms < sent_ms) oldest = start + milliseconds(static_cast<int>(processed_ms / send_rate));
    const auto change = monitor.Update(start + milliseconds(ms), oldest, static_cast<int64_t>(1000.0 * processed_ms));
    if (change.has_value()) changes.push_back(*change);
  }
  return changes;
}

TEST(PaceMonitorTest, ACameraIsBehindIfItIsProcessedTooSlowly) {
  EXPECT_EQ(Changes(1.0, 0.5), std::vector<bool>{true});
  EXPECT_EQ(Changes(1.0, 0.1), std::vector<bool>{true});
  EXPECT_TRUE(Changes(1.0, 1.5).empty());
}

TEST(PaceMonitorTest, AReplayIsBehindOnlyBelowRealTime) {
  EXPECT_TRUE(Changes(20.0, 3.0).empty());
  EXPECT_EQ(Changes(20.0, 0.7), std::vector<bool>{true});
}

TEST(PaceMonitorTest, TheEndOfTheBacklogEndsIt) {
  PaceMonitor monitor;
  PaceMonitor::Time now{std::chrono::hours(1)};
  const PaceMonitor::Time oldest = now;
  EXPECT_FALSE(monitor.Update(now, std::nullopt, 0).has_value());
  EXPECT_FALSE(monitor.Update(now += milliseconds(1500), oldest, 10).has_value());
  EXPECT_EQ(monitor.Update(now += milliseconds(3000), oldest, 20), true);
  EXPECT_TRUE(monitor.is_behind());
  EXPECT_FALSE(monitor.Update(now += milliseconds(10), oldest, 30).has_value());
  EXPECT_EQ(monitor.Update(now += milliseconds(10), std::nullopt, 40), false);
  EXPECT_FALSE(monitor.is_behind());
}

}  // namespace
}  // namespace evpose::server
