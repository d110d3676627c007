// SPDX-License-Identifier: Apache-2.0

// Whether a session is processed as fast as its camera sends.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

namespace evpose::server {

// Not thread-safe, without a clock.
class PaceMonitor {
 public:
  using Time = std::chrono::steady_clock::time_point;

  // The session has processed data up to this sensor time. `oldest_received_at`: of the data that wait, if any. Returns
  // the new value of is_behind() if it has changed.
  std::optional<bool> Update(Time now, std::optional<Time> oldest_received_at, int64_t sensor_time_us);

  // Data have waited for more than two seconds, and in the last two seconds less sensor time was processed than time
  // has passed. A replay that is sent faster than it was recorded is not behind as long as it is processed in real time.
  bool is_behind() const { return is_behind_; }

 private:
  bool is_behind_ = false;
  // The beginning of the interval that is compared.
  Time begin_{};
  int64_t begin_us_ = 0;  // sensor time
};

}  // namespace evpose::server
