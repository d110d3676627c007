// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/math.h"

#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>

// Range reduction after Cody and Waite (Software Manual for the Elementary Functions, 1980), then a Taylor polynomial
// by Horner's rule with a truncation error below half an ulp on the reduced range. Only +, -, *, / and conversions
// are used, which IEEE 754 requires to be rounded correctly.
namespace evpose {
namespace {

// ln 2 and pi / 2 as sums: the low 21 bits of the high part (22 of pi / 2) are 0, so that its product with an integer
// of that many bits is exact. n has at most 11 bits in exp.
constexpr double kLn2High = 0x1.62e42feep-1;
constexpr double kLn2Low = 0x1.a39ef35793c76p-33;
constexpr double kInvLn2 = 0x1.71547652b82fep0;

constexpr double kHalfPiHigh = 0x1.921fb544p0;
constexpr double kHalfPiMiddle = 0x1.0b4611a6p-34;
constexpr double kHalfPiLow = 0x1.3198a2e037073p-69;
constexpr double kTwoOverPi = 0x1.45f306dc9c883p-1;

constexpr double kPi = 0x1.921fb54442d18p1;
constexpr double kHalfPi = 0x1.921fb54442d18p0;

double PowerOfTwo(int64_t exponent) { return std::bit_cast<double>(static_cast<uint64_t>(exponent + 1023) << 52); }

// The nearest integer, ties away from zero; does not depend on the rounding mode. 0 for NaN and beyond the range of
// integers: the result of the caller then is not meaningful, but the conversion is defined.
int64_t NearestInteger(double x) {
  constexpr double kTooMuch = 0x1p62;  // half the range of int64_t
  return std::abs(x) < kTooMuch ? static_cast<int64_t>(x + (x < 0.0 ? -0.5 : 0.5)) : 0;
}

// sin(r) for |r| <= pi/4.
double SinPolynomial(double r) {
  const double r2 = r * r;
  double p = 1.0 / 355687428096000.0;  // 1 / 17!
  p = -1.0 / 1307674368000.0 + r2 * p;
  p = 1.0 / 6227020800.0 + r2 * p;
  p = -1.0 / 39916800.0 + r2 * p;
  p = 1.0 / 362880.0 + r2 * p;
  p = -1.0 / 5040.0 + r2 * p;
  p = 1.0 / 120.0 + r2 * p;
  p = -1.0 / 6.0 + r2 * p;
  return r + r * (r2 * p);
}

// cos(r) for |r| <= pi/4.
double CosPolynomial(double r) {
  const double r2 = r * r;
  double p = 1.0 / 20922789888000.0;  // 1 / 16!
  p = -1.0 / 87178291200.0 + r2 * p;
  p = 1.0 / 479001600.0 + r2 * p;
  p = -1.0 / 3628800.0 + r2 * p;
  p = 1.0 / 40320.0 + r2 * p;
  p = -1.0 / 720.0 + r2 * p;
  p = 1.0 / 24.0 + r2 * p;
  return 1.0 - (0.5 * r2 - r2 * r2 * p);
}

// atan(k / 8), k = 0 .. 8, rounded to nearest.
constexpr double kAtanEighths[] = {
    0.0,
    0.12435499454676144,
    0.24497866312686414,
    0.35877067027057225,
    0.46364760900080615,
    0.55859931534356244,
    0.64350110879328437,
    0.71882999962162453,
    0.78539816339744828,
};

// atan(q) for q in [0, 1]: atan(q) = atan(k/8) + atan((q - k/8) / (1 + q k/8)), the latter argument below 1/16.
double AtanUnit(double q) {
  const int64_t k = NearestInteger(q * 8.0);
  const double base = static_cast<double>(k) * 0.125;
  const double r = (q - base) / (1.0 + q * base);
  const double r2 = r * r;
  double p = -1.0 / 15.0;
  p = 1.0 / 13.0 + r2 * p;
  p = -1.0 / 11.0 + r2 * p;
  p = 1.0 / 9.0 + r2 * p;
  p = -1.0 / 7.0 + r2 * p;
  p = 1.0 / 5.0 + r2 * p;
  p = -1.0 / 3.0 + r2 * p;
  return kAtanEighths[k] + (r + r * (r2 * p));
}

}  // namespace

double DeterministicExp(double x) {
  if (std::isnan(x)) return x;
  if (x < -708.0) return 0.0;
  if (x > 709.0) return std::numeric_limits<double>::infinity();
  const int64_t n = NearestInteger(x * kInvLn2);
  const double r = (x - static_cast<double>(n) * kLn2High) - static_cast<double>(n) * kLn2Low;
  double p = 1.0 / 6227020800.0;  // 1 / 13!
  p = 1.0 / 479001600.0 + r * p;
  p = 1.0 / 39916800.0 + r * p;
  p = 1.0 / 3628800.0 + r * p;
  p = 1.0 / 362880.0 + r * p;
  p = 1.0 / 40320.0 + r * p;
  p = 1.0 / 5040.0 + r * p;
  p = 1.0 / 720.0 + r * p;
  p = 1.0 / 120.0 + r * p;
  p = 1.0 / 24.0 + r * p;
  p = 1.0 / 6.0 + r * p;
  p = 0.5 + r * p;
  return (1.0 + (r + r * r * p)) * PowerOfTwo(n);
}

SinCos DeterministicSinCos(double angle_rad) {
  const int64_t n = NearestInteger(angle_rad * kTwoOverPi);
  const double turns = static_cast<double>(n);
  const double r = ((angle_rad - turns * kHalfPiHigh) - turns * kHalfPiMiddle) - turns * kHalfPiLow;
  const double sin = SinPolynomial(r);
  const double cos = CosPolynomial(r);
  switch (n & 3) {
    case 0:
      return {sin, cos};
    case 1:
      return {cos, -sin};
    case 2:
      return {-sin, -cos};
    default:
      return {-cos, sin};
  }
}

double DeterministicAtan2(double y, double x) {
  const double ax = std::fabs(x);
  const double ay = std::fabs(y);
  if (ax == 0.0 && ay == 0.0) return 0.0;
  double angle = ay <= ax ? AtanUnit(ay / ax) : kHalfPi - AtanUnit(ax / ay);
  if (x < 0.0) angle = kPi - angle;
  return y < 0.0 ? -angle : angle;
}

}  // namespace evpose
