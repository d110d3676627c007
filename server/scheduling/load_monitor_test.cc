// SPDX-License-Identifier: Apache-2.0
#include "server/scheduling/load_monitor.h"

#include <gtest/gtest.h>

#include <cmath>

namespace evpose::server {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::seconds;

// The tests set the clock and the processor time of a monitor of two workers.
class LoadMonitorTest : public ::testing::Test {
 protected:
  LoadMonitor Make(double max_ratio) {
    return LoadMonitor(
        {.num_workers = 2, .cpu = [this] { return cpu_; }, .max_ratio = max_ratio, .now = [this] { return now_; }});
  }
  // Both workers are busy for this share of `duration`.
  void Run(LoadMonitor& monitor, double ratio, seconds duration) {
    for (milliseconds passed{0}; passed < duration; passed += LoadMonitor::kPeriod) {
      now_ += LoadMonitor::kPeriod;
      cpu_ += nanoseconds(std::llround(2.0 * ratio * 1e9 * 0.5));
      monitor.Update();
    }
  }

  LoadMonitor::Time now_{seconds(1000)};
  nanoseconds cpu_ = seconds(77);
};

TEST_F(LoadMonitorTest, AveragesTheProcessorTimePerWorker) {
  LoadMonitor monitor = Make(0.0);
  EXPECT_EQ(monitor.ratio(), 0.0);
  Run(monitor, 0.6, LoadMonitor::kTimeConstant);
  EXPECT_NEAR(monitor.ratio(), 0.6 * (1.0 - std::exp(-1.0)), 1e-9);
  Run(monitor, 0.6, seconds(60));
  EXPECT_NEAR(monitor.ratio(), 0.6, 1e-4);
  Run(monitor, 0.0, LoadMonitor::kTimeConstant);
  EXPECT_NEAR(monitor.ratio(), 0.6 * std::exp(-1.0), 1e-4);
}

TEST_F(LoadMonitorTest, ALongTurnThatEndsInTheIntervalCountsAsFullUse) {
  LoadMonitor monitor = Make(0.0);
  now_ += seconds(1);
  cpu_ += seconds(10);
  monitor.Update();
  EXPECT_NEAR(monitor.ratio(), 1.0 - std::exp(-0.2), 1e-9);
  monitor.Update();  // at the same time
  EXPECT_NEAR(monitor.ratio(), 1.0 - std::exp(-0.2), 1e-9);
}

TEST_F(LoadMonitorTest, IsOverloadedAfterTheTimeAboveTheBoundAndNotBefore) {
  LoadMonitor monitor = Make(0.8);
  Run(monitor, 1.0, seconds(8));  // 1 - exp(-8/5) is 0.798
  EXPECT_LT(monitor.ratio(), 0.8);
  EXPECT_FALSE(monitor.IsOverloaded());
  Run(monitor, 1.0, seconds(5));
  EXPECT_GT(monitor.ratio(), 0.8);
  EXPECT_FALSE(monitor.IsOverloaded()) << "above it for 4.5 s";
  Run(monitor, 1.0, seconds(1));
  EXPECT_TRUE(monitor.IsOverloaded());
  Run(monitor, 0.5, seconds(3));
  EXPECT_FALSE(monitor.IsOverloaded()) << "below it, at once";
  Run(monitor, 1.0, seconds(5));
  EXPECT_GT(monitor.ratio(), 0.8);
  EXPECT_FALSE(monitor.IsOverloaded()) << "the time begins anew";
}

TEST_F(LoadMonitorTest, WithoutABoundNothingIsOverloaded) {
  LoadMonitor monitor = Make(0.0);
  Run(monitor, 1.0, seconds(100));
  EXPECT_FALSE(monitor.IsOverloaded());
}

}  // namespace
}  // namespace evpose::server
