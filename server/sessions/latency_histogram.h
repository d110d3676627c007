// SPDX-License-Identifier: Apache-2.0

// Counts latencies in buckets whose bounds grow by 5 %: percentiles within 5 % from 1 us to 100 s, in fixed memory.
#pragma once

#include <array>
#include <cstdint>

namespace evpose::server {

class LatencyHistogram {
 public:
  void Add(int64_t latency_us);
  // The latency that `fraction` (0..1) of all do not exceed, microseconds; 0 when there is none.
  int64_t Percentile(double fraction) const;

  static void VisitState(auto& archive, auto& self) { archive(self.counts_, self.total_); }

 private:
  static constexpr int kBuckets = 380;  // 1.05^378 is 1e8
  std::array<uint32_t, kBuckets> counts_ = {};
  uint64_t total_ = 0;
};

}  // namespace evpose::server
