// SPDX-License-Identifier: Apache-2.0

// Limits the rate of lines in the log that clients can cause at will, so that other lines are not lost.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "server/runtime/server_clock.h"

namespace evpose::server {

// A token bucket for each event and peer, or event and tenant. Thread-safe.
class LogLimiter {
 public:
  struct Options {
    double lines_per_s = 1.0;  // of each event and peer: enough to see that it continues
    double burst_lines = 5.0;  // after a pause, so that all lines about a single mistake are written
    size_t max_buckets = 256;  // bounds memory and the rate of all peers together; further peers share a bucket
    std::function<absl::Time()> now = MakeServerClock();
  };
  LogLimiter() : LogLimiter(Options()) {}
  explicit LogLimiter(Options options) : options_(std::move(options)) {}

  // Returns nullopt if a line must not be written, else the number of lines that were suppressed since the last one.
  // `peer`: the address of a client, whose ports are not distinguished, because each connection has another one; or a
  // tenant.
  std::optional<uint64_t> Admit(absl::string_view event, absl::string_view peer);

 private:
  struct Bucket {
    double lines = 0.0;  // number of lines that may be written now
    absl::Time filled_at;
    uint64_t suppressed = 0;
  };
  double LinesAt(const Bucket& bucket, absl::Time now) const;

  const Options options_;
  std::mutex mutex_;
  std::map<std::string, Bucket> buckets_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
