// SPDX-License-Identifier: Apache-2.0

// What the Validate() of this folder's options say of a field.
#pragma once

#include <cmath>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace evpose {

inline absl::Status Positive(const char* name, double value) {
  if (std::isfinite(value) && value > 0.0) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(name, " must be positive: ", value));
}

// Both bounds are allowed; not a number is not between them.
inline absl::Status Between(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(name, " must be between ", low, " and ", high, ": ", value));
}

}  // namespace evpose
