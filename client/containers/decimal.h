// SPDX-License-Identifier: Apache-2.0

// Reads decimal numbers in text without binary rounding.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

namespace evpose::client {

// The decimal number `text` ("51.980787001", "-3", "9.8e+01") times 10^`exponent`, rounded to the nearest integer, a
// half away from zero. The decimal digits are rounded, not a binary fraction near them: seconds become the microseconds
// that were written. nullopt for any other text, and for results of more than 18 digits.
std::optional<int64_t> ScaledDecimal(std::string_view text, int exponent);

}  // namespace evpose::client
