// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/due_times.h"

#include <algorithm>

namespace evpose::client {

void DueTimes::Add(uint64_t seq, absl::Time due) {
  const std::lock_guard lock(mutex_);
  if (pieces_.empty() || due - pieces_.back().due >= kStep) {
    pieces_.push_back({seq, due});
  } else {
    pieces_.back().last_seq = seq;
  }
}

absl::Duration DueTimes::Lag(uint64_t processed_seq, absl::Time now) {
  const std::lock_guard lock(mutex_);
  while (!pieces_.empty() && pieces_.front().last_seq <= processed_seq) pieces_.pop_front();
  return pieces_.empty() ? absl::ZeroDuration() : std::max(now - pieces_.front().due, absl::ZeroDuration());
}

}  // namespace evpose::client
