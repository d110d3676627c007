// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/common/call_alarm.h"

#include <gtest/gtest.h>

#include <future>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "server/runtime/failing_allocations_testing.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {
namespace {

// A call whose alarm was lost would never end: each failed allocation must be reported, and an alarm that is reported
// as set must fire.
TEST(CallAlarmTest, AFailedAllocationIsReportedAndTheAlarmCanBeSetAgain) {
  PrepareForOutOfMemory();
  CallAlarm alarm;
  int num_failures = 0;
  bool has_failed = true;
  for (int successes = 0; has_failed; ++successes) {
    absl::Status status;
    std::promise<void> has_fired;
    has_failed = FailsAllocation(
        successes, [&] { status = alarm.Set(absl::ZeroDuration(), [&has_fired] { has_fired.set_value(); }); });
    EXPECT_EQ(IsOutOfMemory(status), has_failed) << status;
    num_failures += has_failed ? 1 : 0;
    if (status.ok()) has_fired.get_future().wait();
  }
  EXPECT_GE(num_failures, 2) << "the alarm and its function are allocated";
}

TEST(CallAlarmTest, TheFunctionCanSetItsAlarm) {
  CallAlarm alarm;
  std::promise<absl::Status> is_set;
  std::promise<void> has_fired;
  const absl::Status first = alarm.Set(absl::ZeroDuration(), [&] {
    is_set.set_value(alarm.Set(absl::ZeroDuration(), [&has_fired] { has_fired.set_value(); }));
  });
  EXPECT_EQ(first, absl::OkStatus());
  EXPECT_EQ(is_set.get_future().get(), absl::OkStatus());
  has_fired.get_future().wait();
}

TEST(CallAlarmTest, ACancelledOrReplacedAlarmDoesNotFire) {
  CallAlarm alarm;
  std::promise<void> has_fired;
  const auto fail = [] { ADD_FAILURE() << "the alarm was cancelled"; };
  EXPECT_EQ(alarm.Set(absl::InfiniteDuration(), fail), absl::OkStatus());
  EXPECT_EQ(alarm.Set(absl::InfiniteDuration(), fail), absl::OkStatus());
  alarm.Cancel();
  EXPECT_EQ(alarm.Set(absl::ZeroDuration(), [&has_fired] { has_fired.set_value(); }), absl::OkStatus());
  has_fired.get_future().wait();
}

}  // namespace
}  // namespace evpose::server
