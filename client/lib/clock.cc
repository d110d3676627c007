#include "client/lib/clock.h"

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
    never_notified.wait_for(lock, stop, absl::ToChronoNanoseconds(time - Now()), [] { return false; });
    return !stop.stop_requested();
  }
};

}  // namespace

Clock& SystemClock() {
  static MonotonicClock clock;
  return clock;
}

}  // namespace evpose::client
