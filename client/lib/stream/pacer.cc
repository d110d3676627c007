// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/pacer.h"

namespace evpose::client {

absl::Time Pacer::DueTime(int64_t t_us) {
  if (!first_t_us_) {
    first_t_us_ = t_us;
    begin_ = clock_.Now();
  }
  // Relative to the first call, not to the previous one, so that delays of single waits do not accumulate.
  return begin_ + absl::Microseconds(t_us - *first_t_us_) / rate_;
}

bool Pacer::Wait(int64_t t_us, std::stop_token stop) {
  if (rate_ <= 0.0 || t_us < 0) return !stop.stop_requested();
  const absl::Time due = DueTime(t_us);
  if (due <= clock_.Now()) return !stop.stop_requested();
  return clock_.SleepUntil(due, stop);
}

}  // namespace evpose::client
