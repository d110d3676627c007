// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <string>

#include "absl/strings/str_format.h"

namespace evpose::client {

// A number in a table; "-" for NaN and infinity.
inline std::string Cell(double value, int decimals) {
  return std::isfinite(value) ? absl::StrFormat("%.*f", decimals, value) : "-";
}

}  // namespace evpose::client
