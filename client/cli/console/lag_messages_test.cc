// SPDX-License-Identifier: Apache-2.0
#include "client/cli/console/lag_messages.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose::client {
namespace {

using ::testing::StartsWith;

TEST(LagMessagesTest, ReportsTheBeginningAndTheEnd) {
  LagMessages messages("real time");
  EXPECT_EQ(messages.Update(absl::Seconds(1), false), "");
  EXPECT_EQ(messages.longest(), absl::ZeroDuration());
  EXPECT_THAT(messages.Update(absl::Milliseconds(1'100), false),
              StartsWith("slower than real time: the oldest events have waited for 1.1 s; "));
  EXPECT_EQ(messages.Update(absl::Seconds(3), false), "");
  EXPECT_EQ(messages.Update(absl::Milliseconds(600), false), "");
  EXPECT_EQ(messages.Update(absl::Milliseconds(400), false), "the events keep up with real time again");
  EXPECT_EQ(messages.Update(absl::ZeroDuration(), false), "");
  EXPECT_EQ(messages.longest(), absl::Seconds(3));
  EXPECT_THAT(messages.Update(absl::Seconds(2), false), StartsWith("slower than real time: "));
}

TEST(LagMessagesTest, ALagWithAnotherMessageIsNotReported) {
  LagMessages messages("--rate 2");
  EXPECT_EQ(messages.Update(absl::Seconds(9), true), "");
  EXPECT_EQ(messages.Update(absl::ZeroDuration(), true), "");
  EXPECT_EQ(messages.longest(), absl::ZeroDuration());
  EXPECT_THAT(messages.Update(absl::Seconds(2), false), StartsWith("slower than --rate 2: "));
  EXPECT_EQ(messages.Update(absl::Seconds(9), true), "");
  EXPECT_EQ(messages.Update(absl::ZeroDuration(), true), "the events keep up with --rate 2 again");
  EXPECT_EQ(messages.longest(), absl::Seconds(2));
}

}  // namespace
}  // namespace evpose::client
