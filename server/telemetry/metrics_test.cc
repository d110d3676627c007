// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/metrics.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <thread>
#include <vector>

#include "server/telemetry/metrics_testing.h"

namespace evpose::server {
namespace {

using std::chrono::microseconds;
using std::chrono::system_clock;

TEST(DurationHistogramTest, EachBucketKeepsItsLatestExemplar) {
  DurationHistogram histogram;
  histogram.Add(microseconds(7));
  histogram.Add(microseconds(8), "");
  histogram.Add(microseconds(8), "not an ID");
  for (const auto& exemplar : histogram.ReadExemplars()) EXPECT_FALSE(exemplar.has_value());
  const std::string first(32, 'a'), second(32, 'b');
  histogram.Add(microseconds(9), first);
  histogram.Add(microseconds(10), second);
  histogram.Add(microseconds(20'000'000), first);
  const auto exemplars = histogram.ReadExemplars();
  ASSERT_TRUE(exemplars.front().has_value());
  EXPECT_EQ(exemplars.front()->trace_id_text(), second);
  EXPECT_EQ(exemplars.front()->duration, microseconds(10));
  ASSERT_TRUE(exemplars.back().has_value());
  EXPECT_EQ(exemplars.back()->trace_id_text(), first);
  EXPECT_EQ(std::count_if(exemplars.begin(), exemplars.end(), [](const auto& slot) { return slot.has_value(); }), 2);
  EXPECT_EQ(NumIn(histogram), 6u);
  const system_clock::time_point time(std::chrono::seconds(5));
  histogram.SetExemplar(microseconds(3), first, time);
  EXPECT_EQ(histogram.ReadExemplars().front()->time, time);
  EXPECT_EQ(NumIn(histogram), 6u) << "the duration was added before";
}

// Threads that set exemplars while they are read: none is a mixture of two.
TEST(DurationHistogramTest, ExemplarsAreWhole) {
  constexpr int kThreads = 4, kRounds = 2000;
  DurationHistogram histogram;
  std::vector<std::thread> writers;
  for (int i = 0; i < kThreads; ++i) {
    writers.emplace_back([&histogram, i] {
      const std::string trace_id(32, static_cast<char>('a' + i));
      for (int round = 0; round < kRounds; ++round) histogram.Add(microseconds(i + 1), trace_id);
    });
  }
  for (int round = 0; round < kRounds; ++round) {
    const auto exemplar = histogram.ReadExemplars().front();
    if (!exemplar.has_value()) continue;
    const char digit = exemplar->trace_id[0];
    EXPECT_EQ(exemplar->trace_id_text(), std::string(32, digit));
    EXPECT_EQ(exemplar->duration, microseconds(digit - 'a' + 1));
  }
  for (std::thread& writer : writers) writer.join();
  EXPECT_EQ(NumIn(histogram), uint64_t{kThreads} * kRounds);
}

}  // namespace
}  // namespace evpose::server
