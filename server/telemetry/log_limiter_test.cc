// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/log_limiter.h"

#include <gtest/gtest.h>

namespace evpose::server {
namespace {

class LogLimiterTest : public testing::Test {
 protected:
  // Returns how many of `attempts` lines may be written.
  int Admitted(absl::string_view event, absl::string_view peer, int attempts) {
    int admitted = 0;
    for (int i = 0; i < attempts; ++i) admitted += limiter_.Admit(event, peer).has_value() ? 1 : 0;
    return admitted;
  }

  absl::Time now_ = absl::UnixEpoch();
  LogLimiter limiter_{{.lines_per_s = 1.0, .burst_lines = 3.0, .max_buckets = 2, .now = [this] { return now_; }}};
};

TEST_F(LogLimiterTest, ABurstThenTheRateWithTheNumberOfSuppressedLines) {
  EXPECT_EQ(Admitted("refused", "ipv4:10.0.0.1:1000", 10), 3);
  EXPECT_EQ(Admitted("refused", "ipv4:10.0.0.1:2000", 10), 0) << "another port is the same peer";
  now_ += absl::Seconds(1);
  EXPECT_EQ(limiter_.Admit("refused", "ipv4:10.0.0.1:3000"), 17u);
  EXPECT_EQ(limiter_.Admit("refused", "ipv4:10.0.0.1:3000"), std::nullopt);
  now_ += absl::Hours(1);
  EXPECT_EQ(limiter_.Admit("refused", "ipv4:10.0.0.1:3000"), 1u);
  EXPECT_EQ(limiter_.Admit("refused", "ipv4:10.0.0.1:3000"), 0u);
  EXPECT_EQ(Admitted("refused", "ipv4:10.0.0.1:3000", 10), 1) << "a pause allows no more than the burst";
}

TEST_F(LogLimiterTest, EventsAndPeersHaveTheirOwnLimits) {
  EXPECT_EQ(Admitted("refused", "ipv4:10.0.0.1:1", 10), 3);
  EXPECT_EQ(Admitted("failed", "ipv4:10.0.0.1:1", 10), 3);
}

TEST_F(LogLimiterTest, PeersBeyondTheMaximumShareOneLimit) {
  EXPECT_EQ(Admitted("refused", "ipv4:10.0.0.1:1", 10), 3);
  EXPECT_EQ(Admitted("refused", "ipv4:10.0.0.2:1", 10), 3);
  EXPECT_EQ(Admitted("refused", "ipv4:10.0.0.3:1", 2), 2);
  EXPECT_EQ(Admitted("refused", "ipv4:10.0.0.4:1", 10), 1);
  now_ += absl::Seconds(10);
  EXPECT_EQ(Admitted("refused", "ipv4:10.0.0.5:1", 10), 3) << "silent peers make room";
}

}  // namespace
}  // namespace evpose::server
