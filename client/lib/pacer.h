// SPDX-License-Identifier: Apache-2.0

// Keeps the pace of the recording: what the sensor saw at t is not sent before its time has come.
#pragma once

#include <cstdint>
#include <optional>
#include <stop_token>

#include "client/lib/clock.h"

namespace evpose::client {

// Not thread-safe.
class Pacer {
 public:
  // `rate`: seconds of the sensor per second of the clock; 0: as fast as possible. `clock` must outlive it.
  Pacer(Clock& clock, double rate) : clock_(clock), rate_(rate) {}

  // Waits until the time of `t_us`, counted from the first call; returns at once when it has passed, as it has when the
  // sensor's clock stepped back. -1 stands for a time not known yet and does not wait. False when `stop` came first.
  bool Wait(int64_t t_us, std::stop_token stop);

 private:
  Clock& clock_;
  double rate_;
  std::optional<int64_t> first_t_us_;
  absl::Time begin_;
};

}  // namespace evpose::client
