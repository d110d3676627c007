// SPDX-License-Identifier: Apache-2.0

// Sends a recording at the rate of real time: delays the data of time t until t has passed.
#pragma once

#include <cstdint>
#include <optional>
#include <stop_token>

#include "evpose/clock.h"

namespace evpose::client {

// Not thread-safe.
class Pacer {
 public:
  // `rate`: seconds of sensor time per second of the clock; 0: unlimited. `clock` must outlive it.
  Pacer(Clock& clock, double rate) : clock_(clock), rate_(rate) {}

  // Waits until the time `t_us` relative to the first call. Returns at once if it has passed, for example after a step
  // back of the sensor's clock, and for -1, an unknown time. Returns false if `stop` was requested first.
  bool Wait(int64_t t_us, std::stop_token stop);
  // Returns the time at which Wait() returns without a step back or a stop. Not for an unlimited rate.
  absl::Time DueTime(int64_t t_us);

 private:
  Clock& clock_;
  double rate_;
  std::optional<int64_t> first_t_us_;
  absl::Time begin_;
};

}  // namespace evpose::client
