// SPDX-License-Identifier: Apache-2.0
#include "client/diagnosis/packet_watch.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

// Adds packets of `period_ms` for two seconds of sensor time. In each second of the host, the events of `ratio` seconds
// of sensor time arrive.
PacketWatch Watch(int period_ms, double ratio) {
  PacketWatch watch;
  const absl::Time begin = absl::UnixEpoch();
  for (int t_ms = 0; t_ms < 2000; t_ms += period_ms) {
    const absl::Time now = begin + absl::Milliseconds(t_ms / ratio);
    watch.Add(now, absl::Milliseconds(period_ms / ratio), int64_t{1000} * t_ms);
    // The rest of the packet arrives without a wait.
    watch.Add(now, absl::ZeroDuration(), int64_t{1000} * t_ms);
  }
  return watch;
}

TEST(PacketWatchTest, PeriodOfPackets) {
  EXPECT_EQ(Watch(4, 1.0).CheckPeriod({}).verdict, Verdict::kOk);
  const Finding finding = Watch(33, 1.0).CheckPeriod({});
  EXPECT_EQ(finding.verdict, Verdict::kAdvice);
  EXPECT_EQ(finding.value, 33.0);
  EXPECT_THAT(finding.remedy, HasSubstr("--period-us"));
  EXPECT_EQ(Watch(100, 1.0).CheckPeriod({}).verdict, Verdict::kProblem);
}

TEST(PacketWatchTest, LagOfAPipe) {
  EXPECT_EQ(Watch(4, 1.0).CheckLag({}).verdict, Verdict::kOk);
  EXPECT_EQ(Watch(4, 0.8).CheckLag({}).verdict, Verdict::kAdvice);
  EXPECT_EQ(Watch(4, 0.5).CheckLag({}).verdict, Verdict::kProblem);
}

TEST(PacketWatchTest, FileIsNotLive) {
  EXPECT_EQ(Watch(4, 5.0).CheckPeriod({}).verdict, Verdict::kNotChecked);
  EXPECT_THAT(Watch(4, 5.0).CheckLag({}).text, HasSubstr("a file"));
  EXPECT_EQ(PacketWatch().CheckLag({}).verdict, Verdict::kNotChecked);
}

}  // namespace
}  // namespace evpose::client
