// SPDX-License-Identifier: Apache-2.0

// A histogram of latencies with geometric buckets: percentiles are accurate to 5 % from 1 us to 100 s, in fixed memory.
#pragma once

#include <array>
#include <cstdint>

#include "absl/types/span.h"

namespace evpose::server {

class LatencyHistogram {
 public:
  LatencyHistogram() = default;
  // Restores a histogram from counts(), which an earlier version with fewer buckets may have written.
  explicit LatencyHistogram(absl::Span<const uint32_t> counts);

  void Add(int64_t latency_us);
  // The quantile `fraction` (0..1) of the latencies, microseconds; 0 when none was added.
  int64_t Percentile(double fraction) const;
  // The number of latencies in each bucket, without the empty buckets at the end.
  absl::Span<const uint32_t> counts() const;

 private:
  static constexpr int kBuckets = 380;  // 1.05^378 is 1e8
  std::array<uint32_t, kBuckets> counts_ = {};
  uint64_t total_ = 0;
};

}  // namespace evpose::server
