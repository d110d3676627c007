// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/number_range.h"

#include <gtest/gtest.h>

namespace evpose {
namespace {

TEST(NumberRangeTest, AcceptsNumbersWithinItsLimitsOnly) {
  const NumberRange range(0.5, 4.0);
  for (const char* number : {"0.5", "1e0", "4"}) EXPECT_EQ(range(number), "") << number;
  for (const char* number : {"0.4", "4.1", "nan", "-NaN", "nan(1)", "inf", "-inf", "", "x"}) {
    EXPECT_EQ(range(number), absl::StrCat("Value ", number, " not in range 0.500000 to 4.000000"));
  }
  EXPECT_EQ(NumberRange(1, 3)("2"), "");
  EXPECT_EQ(NumberRange(1, 3)("nan"), "Value nan not in range 1 to 3");
}

TEST(FiniteNumberTest, AcceptsNumbersOfEitherSign) {
  for (const char* number : {"0", "-1.5", "1e9"}) EXPECT_EQ(FiniteNumber()(number), "") << number;
  for (const char* number : {"", "nan", "inf", "-infinity", "1e999", "x"}) {
    EXPECT_EQ(FiniteNumber()(number), absl::StrCat("\"", number, "\" is not a number"));
  }
}

TEST(WholeNumberTest, AcceptsNumbersOf64BitsWithoutASign) {
  for (const char* number : {"0", "7", "18446744073709551615"}) EXPECT_EQ(WholeNumber()(number), "") << number;
  for (const char* number : {"", "-1", "1.5", "18446744073709551616", "1e3", "x"}) {
    EXPECT_EQ(WholeNumber()(number),
              absl::StrCat("\"", number, "\" is not a whole number from 0 to 18446744073709551615"));
  }
}

}  // namespace
}  // namespace evpose
