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

// Without an alarm, the call would never end. In this test only the allocation of the alarm fails, because an exception
// within gRPC would leave the state of gRPC inconsistent.
TEST(CallAlarmTest, AFailedAllocationIsReportedAndTheAlarmCanBeSetAgain) {
  PrepareForOutOfMemory();
  CallAlarm alarm;
  absl::Status status;
  const auto fail = [] { ADD_FAILURE() << "the alarm was not set"; };
  EXPECT_TRUE(FailsAllocation(0, [&] { status = alarm.Set(absl::ZeroDuration(), fail); }));
  EXPECT_TRUE(IsOutOfMemory(status)) << status;
  std::promise<void> has_fired;
  EXPECT_EQ(alarm.Set(absl::ZeroDuration(), [&has_fired] { has_fired.set_value(); }), absl::OkStatus());
  has_fired.get_future().wait();
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
