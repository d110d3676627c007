// SPDX-License-Identifier: Apache-2.0

// The clock by which a server measures expiry.
#pragma once

#include <chrono>
#include <functional>
#include <utility>

#include "absl/time/clock.h"
#include "absl/time/time.h"

namespace evpose::server {

// Returns a clock that begins with the time of the wall clock and advances with the steady clock. So a step of the wall
// clock (NTP on a machine that boots in 1970) neither expires the sessions of this process nor keeps them for ever.
inline std::function<absl::Time()> MakeServerClock(
    const std::function<absl::Time()>& wall = absl::Now,
    std::function<std::chrono::steady_clock::time_point()> steady = std::chrono::steady_clock::now) {
  const absl::Time begin = wall();
  const auto steady_begin = steady();
  return
      [begin, steady_begin, steady = std::move(steady)] { return begin + absl::FromChrono(steady() - steady_begin); };
}

}  // namespace evpose::server
