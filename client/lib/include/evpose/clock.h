// SPDX-License-Identifier: Apache-2.0

// A clock interface, so that tests need not wait.
#pragma once

#include <stop_token>

#include "absl/time/time.h"

namespace evpose::client {

class Clock {
 public:
  virtual ~Clock() = default;
  // Monotonic; its epoch is arbitrary.
  virtual absl::Time Now() = 0;
  // Returns false if `stop` was requested before `time`.
  virtual bool SleepUntil(absl::Time time, std::stop_token stop) = 0;
};

// The monotonic clock of the machine.
Clock& SystemClock();

}  // namespace evpose::client
