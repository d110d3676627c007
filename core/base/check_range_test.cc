// SPDX-License-Identifier: Apache-2.0
#include "core/base/check_range.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>

namespace evpose {
namespace {

TEST(CheckRangeTest, TheEndsBelongToTheRangeUnlessOpen) {
  for (const OpenEnds open : {OpenEnds::kNone, OpenEnds::kLow, OpenEnds::kHigh, OpenEnds::kBoth}) {
    EXPECT_EQ(CheckRange("x", 1.0, 1.0, 2.0, open).ok(), open == OpenEnds::kNone || open == OpenEnds::kHigh);
    EXPECT_EQ(CheckRange("x", 2.0, 1.0, 2.0, open).ok(), open == OpenEnds::kNone || open == OpenEnds::kLow);
    EXPECT_TRUE(CheckRange("x", 1.5, 1.0, 2.0, open).ok());
    EXPECT_FALSE(CheckRange("x", 0.9, 1.0, 2.0, open).ok());
    EXPECT_FALSE(CheckRange("x", 2.1, 1.0, 2.0, open).ok());
    EXPECT_FALSE(CheckRange("x", NAN, 1.0, 2.0, open).ok());
  }
}

TEST(CheckRangeTest, TheErrorHasFieldValueAndRange) {
  EXPECT_EQ(CheckRange("a.b", 0.0, 0.01, 1e6).message(), "a.b is 0; it must lie in [0.01, 1000000]");
  EXPECT_EQ(CheckRange("a.b", 12345678.0, 0.0, 3.5, OpenEnds::kLow).message(),
            "a.b is 12345678; it must lie in (0, 3.5]");
  EXPECT_EQ(CheckRange("a.b", -1.0, 0.0, INFINITY, OpenEnds::kHigh).message(), "a.b is -1; it must lie in [0, inf)");
  EXPECT_EQ(CheckRange("a.b", NAN, 0.0, 1.0, OpenEnds::kBoth).message(), "a.b is nan; it must lie in (0, 1)");
}

TEST(CheckPositiveTest, IsFiniteAndAboveZero) {
  EXPECT_TRUE(CheckPositive("x", 1e-300).ok());
  for (const double bad : {0.0, -1.0, static_cast<double>(NAN), HUGE_VAL}) EXPECT_FALSE(CheckPositive("x", bad).ok());
  EXPECT_EQ(CheckPositive("x", 0.0).message(), "x is 0; it must be positive");
}

}  // namespace
}  // namespace evpose
