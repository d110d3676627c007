// SPDX-License-Identifier: Apache-2.0

// Helpers of the tests of this folder.
#pragma once

#include "core/windows/event_window.h"

namespace evpose {

// Limits that a few events reach, so that short streams close windows for every reason.
inline WindowOptions SmallOptions() {
  WindowOptions options;
  options.interval_us = 100;
  options.min_interval_us = 40;
  options.max_duration_us = 1000;
  options.min_events = 5;
  options.max_events = 64;
  options.max_gap_us = 5000;
  return options;
}

}  // namespace evpose
