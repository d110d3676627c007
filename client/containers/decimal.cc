// SPDX-License-Identifier: Apache-2.0
#include "client/containers/decimal.h"

#include <algorithm>

namespace evpose::client {
namespace {

constexpr int kMaxDigits = 18;        // number of digits of a result; 10^18 fits int64_t
constexpr int kMaxExponent = 10'000;  // beyond it a result is 0 or too large

bool IsDigit(char c) { return c >= '0' && c <= '9'; }

// Removes a sign from the front of `text`; true for '-'.
bool TakeSign(std::string_view& text) {
  if (text.empty() || (text[0] != '-' && text[0] != '+')) return false;
  const bool is_negative = text[0] == '-';
  text.remove_prefix(1);
  return is_negative;
}

// The significant digits of a number, those beyond kMaxDigits summarised.
struct Digits {
  int64_t value = 0;
  int count = 0;     // in `value`, leading zeros excepted
  int exponent = 0;  // the number is `value` times 10^exponent, and a fraction of a unit if digits were left out
  bool any = false;

  void Add(char digit, bool is_fraction) {
    any = true;
    if (count == kMaxDigits) {
      exponent += is_fraction ? 0 : 1;
      return;
    }
    value = value * 10 + (digit - '0');
    count += value > 0 ? 1 : 0;
    exponent -= is_fraction ? 1 : 0;
  }
};

// Reads "e+01" at the front of `text`; false if it is none.
bool TakeExponent(std::string_view& text, int& exponent) {
  text.remove_prefix(1);
  const bool is_negative = TakeSign(text);
  if (text.empty() || !IsDigit(text[0])) return false;
  int value = 0;
  while (!text.empty() && IsDigit(text[0])) {
    value = std::min(value * 10 + (text[0] - '0'), kMaxExponent);
    text.remove_prefix(1);
  }
  exponent += is_negative ? -value : value;
  return true;
}

}  // namespace

std::optional<int64_t> ScaledDecimal(std::string_view text, int exponent) {
  const bool is_negative = TakeSign(text);
  Digits digits;
  for (bool is_fraction = false; !text.empty(); text.remove_prefix(1)) {
    if (IsDigit(text[0])) {
      digits.Add(text[0], is_fraction);
    } else if (text[0] == '.' && !is_fraction) {
      is_fraction = true;
    } else {
      break;
    }
  }
  if (!digits.any) return std::nullopt;
  digits.exponent += exponent;
  if (!text.empty() && (text[0] == 'e' || text[0] == 'E') && !TakeExponent(text, digits.exponent)) return std::nullopt;
  if (!text.empty()) return std::nullopt;
  int64_t value = digits.value;
  if (value != 0 && digits.count + digits.exponent > kMaxDigits) return std::nullopt;
  int64_t last = 0;  // the digit behind the units
  for (int i = digits.exponent; i < 0 && (value != 0 || last != 0); ++i) {
    last = value % 10;
    value /= 10;
  }
  if (last >= 5) ++value;
  for (int i = 0; i < digits.exponent && value != 0; ++i) value *= 10;
  return is_negative ? -value : value;
}

}  // namespace evpose::client
