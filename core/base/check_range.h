// SPDX-License-Identifier: Apache-2.0

// The check that every options struct makes of its numbers.
#pragma once

#include <cmath>

#include "absl/status/status.h"
#include "absl/strings/str_format.h"

namespace evpose {

// INVALID_ARGUMENT with the field's name ("MotionOptions.depth_m"), its value and the range, unless low <= value <=
// high; also for NaN.
inline absl::Status CheckRange(const char* field, double value, double low, double high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("%s is %g; it must lie in [%g, %g]", field, value, low, high));
}

// INVALID_ARGUMENT with the field's name and its value unless the value is finite and above zero.
inline absl::Status CheckPositive(const char* field, double value) {
  if (std::isfinite(value) && value > 0.0) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("%s is %g; it must be positive", field, value));
}

}  // namespace evpose
