// SPDX-License-Identifier: Apache-2.0

// A clock for tests: sleeping takes no time and advances the clock.
#pragma once

#include <mutex>

#include "evpose/clock.h"

namespace evpose::client {

class FakeClock final : public Clock {
 public:
  absl::Time Now() override {
    std::lock_guard lock(mutex_);
    return now_;
  }
  bool SleepUntil(absl::Time time, std::stop_token stop) override {
    std::lock_guard lock(mutex_);
    if (time > now_) now_ = time;
    return !stop.stop_requested();
  }
  void Advance(absl::Duration duration) {
    std::lock_guard lock(mutex_);
    now_ += duration;
  }

 private:
  std::mutex mutex_;
  absl::Time now_ = absl::UnixEpoch();
};

}  // namespace evpose::client
