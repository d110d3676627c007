// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/reusable_timer.h"

#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>
#include <memory>
#include <new>

#include "server/runtime/failing_allocations_testing.h"

namespace evpose::server {
namespace {

TEST(ReusableTimerTest, IsArmedAgainWithoutAnAllocation) {
  boost::asio::io_context context;
  int num_runs = 0;
  std::unique_ptr<ReusableTimer> timer;
  timer = std::make_unique<ReusableTimer>(context.get_executor(), [&] {
    ++num_runs;
    if (num_runs == 10) return;
    ThisThreadsFailingAllocation().successes_before = 0;
    timer->Arm(absl::ZeroDuration());
    EXPECT_EQ(ThisThreadsFailingAllocation().successes_before, 0) << "no allocation has failed";
    ThisThreadsFailingAllocation().successes_before = -1;
    throw std::bad_alloc();  // does not stop the timer
  });
  timer->Arm(absl::ZeroDuration());
  context.run();
  EXPECT_EQ(num_runs, 10);
}

TEST(ReusableTimerTest, AReplacedWaitDoesNotRun) {
  boost::asio::io_context context;
  int num_runs = 0;
  ReusableTimer timer(context.get_executor(), [&] { ++num_runs; });
  timer.Arm(absl::Hours(1));
  timer.Arm(absl::ZeroDuration());
  context.run();
  EXPECT_EQ(num_runs, 1);
}

TEST(ReusableTimerTest, ACancelledWaitMayOutliveTheTimer) {
  boost::asio::io_context context;
  const auto is_alive = std::make_shared<bool>(true);
  {
    ReusableTimer timer(context.get_executor(), [is_alive] { *is_alive = false; });
    timer.Arm(absl::ZeroDuration());
  }
  EXPECT_EQ(is_alive.use_count(), 2) << "held by the wait";
  context.run();
  EXPECT_TRUE(*is_alive);
  EXPECT_EQ(is_alive.use_count(), 1);
}

}  // namespace
}  // namespace evpose::server
