// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/math.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>

#include "core/numerics/hash.h"
#include "core/numerics/random.h"

namespace evpose {
namespace {

constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

TEST(DeterministicMathTest, ExpIsWithinTwoUlp) {
  Random random(1);
  for (int i = 0; i < 200'000; ++i) {
    const double x = random.Uniform(-708.0, 709.0);
    EXPECT_NEAR(DeterministicExp(x) / std::exp(x), 1.0, 2.0 * kEpsilon) << x;
  }
  EXPECT_EQ(DeterministicExp(0.0), 1.0);
}

TEST(DeterministicMathTest, ExpAtItsLimits) {
  EXPECT_EQ(DeterministicExp(-709.0), 0.0);
  EXPECT_EQ(DeterministicExp(-INFINITY), 0.0);
  EXPECT_EQ(DeterministicExp(710.0), INFINITY);
  EXPECT_TRUE(std::isnan(DeterministicExp(NAN)));
}

TEST(RoundNonNegativeTest, IsTheNearestInteger) {
  for (const double value : {-0.49, 0.0, 0.49, 0.5, 0.51, 1.5, 7.25, 1e6 + 0.75}) {
    EXPECT_EQ(RoundNonNegative(value), static_cast<int>(std::floor(value + 0.5))) << value;
    EXPECT_EQ(RoundNonNegative(static_cast<float>(value)), RoundNonNegative(value)) << value;
  }
}

TEST(DeterministicMathTest, SinCosIsCloseToTheLibrary) {
  Random random(2);
  for (double range : {1.0, 10.0, 1e5}) {
    for (int i = 0; i < 100'000; ++i) {
      const double angle = random.Uniform(-range, range);
      const SinCos result = DeterministicSinCos(angle);
      const double tolerance = 1e-15 * std::max(1.0, std::fabs(angle));
      ASSERT_NEAR(result.sin, std::sin(angle), tolerance) << angle;
      ASSERT_NEAR(result.cos, std::cos(angle), tolerance) << angle;
    }
  }
}

TEST(DeterministicMathTest, NanStaysNan) {
  const double infinity = std::numeric_limits<double>::infinity();
  const double none = std::numeric_limits<double>::quiet_NaN();
  for (const double angle_rad : {none, infinity, -infinity, 1.5e76, -1e300}) {
    const SinCos sin_cos = DeterministicSinCos(angle_rad);
    EXPECT_FALSE(std::isfinite(sin_cos.sin) || std::isfinite(sin_cos.cos)) << angle_rad;
  }
  EXPECT_TRUE(std::isnan(DeterministicExp(none)));
  EXPECT_TRUE(std::isnan(DeterministicAtan2(none, 1.0)));
  EXPECT_TRUE(std::isnan(DeterministicAtan2(1.0, none)));
  EXPECT_TRUE(std::isnan(DeterministicAtan2(infinity, infinity)));
}

TEST(DeterministicMathTest, SmallAnglesKeepTheirRelativePrecision) {
  for (double angle : {1e-3, 1e-8, 1e-300}) EXPECT_EQ(DeterministicSinCos(angle).sin / std::sin(angle), 1.0);
}

TEST(DeterministicMathTest, Atan2IsCloseToTheLibrary) {
  Random random(3);
  for (int i = 0; i < 200'000; ++i) {
    const double y = random.Uniform(-1.0, 1.0);
    const double x = random.Uniform(-1.0, 1.0);
    const double expected = std::atan2(y, x);
    ASSERT_NEAR(DeterministicAtan2(y, x), expected, 4.0 * kEpsilon * std::fabs(expected)) << y << " " << x;
  }
  EXPECT_EQ(DeterministicAtan2(0.0, 0.0), 0.0);
  EXPECT_EQ(DeterministicAtan2(0.0, -1.0), std::atan2(0.0, -1.0));
  EXPECT_EQ(DeterministicAtan2(-1.0, 0.0), std::atan2(-1.0, 0.0));
}

// The bits themselves: a compiler or processor that contracts or reorders an operation changes this digest.
TEST(DeterministicMathTest, BitsAreFixed) {
  Random random(4);
  Sha256 hash;
  const auto add = [&hash](double value) {
    uint8_t bytes[sizeof value];
    std::memcpy(bytes, &value, sizeof value);
    hash.Update(bytes);
  };
  for (int i = 0; i < 10'000; ++i) {
    const double x = random.Uniform(-20.0, 20.0);
    const SinCos sin_cos = DeterministicSinCos(x);
    add(DeterministicExp(x));
    add(sin_cos.sin);
    add(sin_cos.cos);
    add(DeterministicAtan2(x, random.Uniform(-20.0, 20.0)));
  }
  EXPECT_EQ(hash.FinishHex(), "a32e1bcd114f33a42d0358af72eb5ed39f23235cbc3af663f6eef8c881af761d");
}

}  // namespace
}  // namespace evpose
