// SPDX-License-Identifier: Apache-2.0
#include "core/base/check_range.h"

#include <cmath>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace evpose {
namespace {

// Counts and microseconds in full; six significant digits of other numbers.
std::string Text(double value) {
  constexpr double kMaxExact = 0x1p53;  // larger integers are rounded
  const bool is_integer = std::abs(value) <= kMaxExact && value == std::trunc(value);
  return is_integer ? absl::StrFormat("%.0f", value) : absl::StrFormat("%g", value);
}

}  // namespace

absl::Status CheckRange(const char* field, double value, double low, double high, OpenEnds open) {
  const bool is_open_below = open == OpenEnds::kLow || open == OpenEnds::kBoth;
  const bool is_open_above = open == OpenEnds::kHigh || open == OpenEnds::kBoth;
  const bool is_above = is_open_below ? value > low : value >= low;
  const bool is_below = is_open_above ? value < high : value <= high;
  if (is_above && is_below) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(field, " is ", Text(value), "; it must lie in ",
                                                 is_open_below ? "(" : "[", Text(low), ", ", Text(high),
                                                 is_open_above ? ")" : "]"));
}

absl::Status CheckPositive(const char* field, double value) {
  if (std::isfinite(value) && value > 0.0) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(field, " is ", Text(value), "; it must be positive"));
}

}  // namespace evpose
