// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/latency_histogram.h"

#include <gtest/gtest.h>

namespace evpose::server {
namespace {

TEST(LatencyHistogramTest, PercentilesAreWithinFivePercent) {
  LatencyHistogram histogram;
  EXPECT_EQ(histogram.Percentile(0.5), 0);
  for (int latency_us = 1; latency_us <= 10'000; ++latency_us) histogram.Add(latency_us);
  EXPECT_NEAR(static_cast<double>(histogram.Percentile(0.5)), 5000, 0.05 * 5000 + 1);
  EXPECT_NEAR(static_cast<double>(histogram.Percentile(0.99)), 9900, 0.05 * 9900 + 1);
  EXPECT_LE(histogram.Percentile(0.0), 1);
}

TEST(LatencyHistogramTest, AcceptsValuesOutsideItsRange) {
  LatencyHistogram histogram;
  histogram.Add(-5);
  EXPECT_EQ(histogram.Percentile(1.0), 1);
  histogram.Add(int64_t{1} << 60);
  EXPECT_GT(histogram.Percentile(1.0), 100'000'000);
}

}  // namespace
}  // namespace evpose::server
