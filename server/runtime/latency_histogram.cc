// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/latency_histogram.h"

#include <algorithm>
#include <cmath>

namespace evpose::server {
namespace {

constexpr double kGrowth = 1.05;  // ratio of the bounds of neighbouring buckets: percentiles are accurate to 5 %

}  // namespace

LatencyHistogram::LatencyHistogram(absl::Span<const uint32_t> counts) {
  for (size_t i = 0; i < counts.size(); ++i) {
    counts_[std::min<size_t>(i, kBuckets - 1)] += counts[i];
    total_ += counts[i];
  }
}

absl::Span<const uint32_t> LatencyHistogram::counts() const {
  size_t size = kBuckets;
  while (size > 0 && counts_[size - 1] == 0) --size;
  return absl::MakeConstSpan(counts_).first(size);
}

void LatencyHistogram::Add(int64_t latency_us) {
  const double bucket = std::ceil(std::log(static_cast<double>(std::max<int64_t>(latency_us, 1))) / std::log(kGrowth));
  ++counts_[std::min(static_cast<int>(bucket), kBuckets - 1)];
  ++total_;
}

int64_t LatencyHistogram::Percentile(double fraction) const {
  if (total_ == 0) return 0;
  const auto wanted = static_cast<uint64_t>(std::ceil(fraction * static_cast<double>(total_)));
  uint64_t seen = 0;
  for (int i = 0; i < kBuckets; ++i) {
    seen += counts_[i];
    if (seen >= std::max<uint64_t>(wanted, 1)) return static_cast<int64_t>(std::pow(kGrowth, i));
  }
  return static_cast<int64_t>(std::pow(kGrowth, kBuckets - 1));
}

}  // namespace evpose::server
