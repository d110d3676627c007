// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/connection_messages.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace evpose::client {
namespace {

ConnectionChange Away(double away_s) {
  ConnectionChange change;
  change.is_unreachable = true;
  change.server = "host:1";
  change.cause = absl::UnavailableError("connection refused");
  change.outage = absl::Seconds(away_s);
  change.next_try_in = absl::Seconds(2);
  change.kept_bytes = 3'100'000;
  return change;
}

TEST(ConnectionMessagesTest, ReportsDurationCauseAndKeptData) {
  ConnectionMessages lines;
  EXPECT_EQ(lines.Describe(Away(12)),
            "no connection for 12.0 s (connection refused); 3.1 MB kept; next try in 2.0 s at host:1");
  ConnectionChange full = Away(13);
  full.source_waits = true;
  EXPECT_EQ(
      lines.Describe(full),
      "no connection for 13.0 s (connection refused); 3.1 MB kept, no room for more: the source waits; next try in "
      "2.0 s at host:1");
  ConnectionChange back = Away(14);
  back.is_unreachable = false;
  EXPECT_EQ(lines.Describe(back), "host:1: connected again after 14.0 s; 3.1 MB kept");
  lines.Describe(Away(1));
  lines.Describe(back);
  EXPECT_EQ(lines.outages(), 2);
  EXPECT_EQ(lines.away_for(), absl::Seconds(28));
}

TEST(ConnectionMessagesTest, NamesTheStreamThatBrokeAndTheNewOne) {
  ConnectionMessages lines;
  ConnectionChange change = Away(1);
  change.trace = {"0af7", "b7ad"};
  EXPECT_THAT(lines.Describe(change), ::testing::EndsWith(" at host:1; trace_id=0af7 span_id=b7ad"));
  EXPECT_THAT(lines.Describe(change), ::testing::EndsWith(" at host:1"));
  change.is_unreachable = false;
  change.trace.span_id = "00f0";
  EXPECT_EQ(lines.Describe(change), "host:1: connected again after 1.0 s; 3.1 MB kept; trace_id=0af7 span_id=00f0");
}

TEST(ConnectionMessagesTest, RepeatsAtMostOnceAMinute) {
  ConnectionMessages lines;
  int num_lines = 0;
  for (int away_s = 0; away_s < 3600; away_s += 5) num_lines += !lines.Describe(Away(away_s)).empty();
  EXPECT_GT(num_lines, 55);
  EXPECT_LT(num_lines, 70);
}

}  // namespace
}  // namespace evpose::client
