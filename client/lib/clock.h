// SPDX-License-Identifier: Apache-2.0

// Time as the client library sees it, so that tests need not wait.
#pragma once

#include <stop_token>

#include "absl/time/time.h"

namespace evpose::client {

class Clock {
 public:
  virtual ~Clock() = default;
  // Never steps back; its epoch means nothing.
  virtual absl::Time Now() = 0;
  // False when `stop` was requested before `time`.
  virtual bool SleepUntil(absl::Time time, std::stop_token stop) = 0;
};

// The machine's monotonic clock.
Clock& SystemClock();

}  // namespace evpose::client
