// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/log_limiter.h"

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace evpose::server {

double LogLimiter::LinesAt(const Bucket& bucket, absl::Time now) const {
  const double elapsed_s = absl::ToDoubleSeconds(now - bucket.filled_at);
  return std::min(bucket.lines + elapsed_s * options_.lines_per_s, options_.burst_lines);
}

std::optional<uint64_t> LogLimiter::Admit(absl::string_view event, absl::string_view peer) {
  const std::lock_guard lock(mutex_);
  const absl::Time now = options_.now();
  std::string key = absl::StrCat(event, " ", peer.substr(0, peer.rfind(':')));
  if (!buckets_.contains(key) && buckets_.size() >= options_.max_buckets) {
    // A full bucket is that of a silent peer.
    std::erase_if(buckets_, [&](const auto& entry) { return LinesAt(entry.second, now) >= options_.burst_lines; });
    if (buckets_.size() >= options_.max_buckets) key = std::string(event);
  }
  Bucket& bucket = buckets_.try_emplace(std::move(key), Bucket{options_.burst_lines, now}).first->second;
  bucket.lines = LinesAt(bucket, now);
  bucket.filled_at = now;
  if (bucket.lines < 1.0) {
    ++bucket.suppressed;
    return std::nullopt;
  }
  bucket.lines -= 1.0;
  return std::exchange(bucket.suppressed, 0);
}

}  // namespace evpose::server
