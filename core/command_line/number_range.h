// SPDX-License-Identifier: Apache-2.0

// Checks of numbers on the command line.
#pragma once

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdint>
#include <string>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace evpose {

// CLI::Range without NaN, which CLI::Range accepts because NaN is neither below nor above its limits.
class NumberRange : public CLI::Range {
 public:
  template <typename Number>
  NumberRange(Number least, Number most) : CLI::Range(least, most) {
    func_ = [check = func_, least, most](std::string& input) {
      double number = 0.0;
      const bool is_nan = absl::SimpleAtod(input, &number) && std::isnan(number);
      if (!is_nan) return check(input);
      return absl::StrCat("Value ", input, " not in range ", std::to_string(least), " to ", std::to_string(most));
    };
  }
};

// Any number but NaN and the infinities.
inline CLI::Validator FiniteNumber() {
  return CLI::Validator(
      [](std::string& input) {
        double number = 0.0;
        if (absl::SimpleAtod(input, &number) && std::isfinite(number)) return std::string();
        return absl::StrCat("\"", input, "\" is not a number");
      },
      "");
}

// A whole number of 64 bits without a sign. Without this check CLI11 converts "-1" and numbers that are too large to
// the largest one, and an empty text to 0.
inline CLI::Validator WholeNumber() {
  return CLI::Validator(
      [](std::string& input) {
        uint64_t number = 0;
        if (absl::SimpleAtoi(input, &number)) return std::string();
        return absl::StrCat("\"", input, "\" is not a whole number from 0 to ", UINT64_MAX);
      },
      "");
}

}  // namespace evpose
