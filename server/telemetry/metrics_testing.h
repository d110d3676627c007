// SPDX-License-Identifier: Apache-2.0

// Helpers for tests of metrics.
#pragma once

#include <cstdint>
#include <numeric>

#include "server/telemetry/metrics.h"

namespace evpose::server {

// The number of durations in a histogram.
inline uint64_t NumIn(const DurationHistogram& histogram) {
  const DurationHistogram::Reading reading = histogram.Read();
  return std::accumulate(reading.counts.begin(), reading.counts.end(), uint64_t{0});
}

}  // namespace evpose::server
