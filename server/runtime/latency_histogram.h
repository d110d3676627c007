// SPDX-License-Identifier: Apache-2.0

// Counts latencies in buckets whose bounds grow by 5 %: percentiles within 5 % from 1 us to 100 s, in fixed memory.
#pragma once

#include <array>
#include <cstdint>

#include "absl/types/span.h"

namespace evpose::server {

class LatencyHistogram {
 public:
  LatencyHistogram() = default;
  // From the counts() of another one, maybe of a version with fewer buckets.
  explicit LatencyHistogram(absl::Span<const uint32_t> counts);

  void Add(int64_t latency_us);
  // The latency that `fraction` (0..1) of all do not exceed, microseconds; 0 when there is none.
  int64_t Percentile(double fraction) const;
  // By bucket, without the empty ones at the end.
  absl::Span<const uint32_t> counts() const;

 private:
  static constexpr int kBuckets = 380;  // 1.05^378 is 1e8
  std::array<uint32_t, kBuckets> counts_ = {};
  uint64_t total_ = 0;
};

}  // namespace evpose::server
