// SPDX-License-Identifier: Apache-2.0

// The checks that the Validate() of every options struct makes of its numbers.
#pragma once

#include "absl/status/status.h"

namespace evpose {

// Which limits of a range do not belong to it.
enum class OpenEnds {
  kNone,  // [low, high]
  kLow,   // (low, high]
  kHigh,  // [low, high)
  kBoth,  // (low, high)
};

// INVALID_ARGUMENT unless the value lies in the range, also for NaN. The error has the field's name, its value and the
// range: "MotionOptions.depth_m is 0; it must lie in [0.01, 10000]". Integers up to 2^53 are exact.
absl::Status CheckRange(const char* field, double value, double low, double high, OpenEnds open = OpenEnds::kNone);

// INVALID_ARGUMENT with the field's name and its value unless the value is finite and above zero.
absl::Status CheckPositive(const char* field, double value);

}  // namespace evpose
