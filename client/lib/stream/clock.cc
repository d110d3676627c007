// SPDX-License-Identifier: Apache-2.0
#include "evpose/clock.h"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <mutex>

namespace evpose::client {
namespace {

class MonotonicClock final : public Clock {
 public:
  absl::Time Now() override {
    return absl::UnixEpoch() + absl::FromChrono(std::chrono::steady_clock::now().time_since_epoch());
  }

  bool SleepUntil(absl::Time time, std::stop_token stop) override {
    std::mutex mutex;
    std::condition_variable_any never_notified;
    std::unique_lock lock(mutex);
    // The wait is divided into steps, because an infinite duration overflows the clock of the standard library.
    constexpr absl::Duration kLongestStep = absl::Hours(1);
    for (absl::Duration left = time - Now(); left > absl::ZeroDuration(); left = time - Now()) {
      const auto step = absl::ToChronoNanoseconds(std::min(left, kLongestStep));
      never_notified.wait_for(lock, stop, step, [] { return false; });
      if (stop.stop_requested()) return false;
    }
    return !stop.stop_requested();
  }
};

}  // namespace

Clock& SystemClock() {
  static MonotonicClock clock;
  return clock;
}

}  // namespace evpose::client
