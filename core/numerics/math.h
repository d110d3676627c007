// SPDX-License-Identifier: Apache-2.0

// Elementary functions that give the same bits on every machine (core/numerics/README.md, section 1). Those of the C
// library have a variant for each kind of processor, which differ in the last bit. All code between the decoder and a
// pose uses these functions. sqrt and the four operations need none: IEEE 754 requires them to be rounded correctly.
#pragma once

#include <cmath>
#include <numbers>

namespace evpose {

inline constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;
inline constexpr double kRadiansPerDegree = std::numbers::pi / 180.0;  // has other last bits than 1 / kDegreesPerRadian

// e^x, within 2 ulp for x in [-708, 709]; 0 below, +infinity above, NaN for NaN.
double DeterministicExp(double x);

struct SinCos {
  double sin;
  double cos;
};
// Sine and cosine of an angle in radians, |angle| <= 1e5, with an absolute error below 1e-15 max(1, |angle|).
SinCos DeterministicSinCos(double angle_rad);

// The length of the vector (x, y), within 1 ulp if neither square overflows or underflows. The std::hypot of some
// processors uses a fused multiply-add.
inline double Hypotenuse(double x, double y) { return std::sqrt(x * x + y * y); }

// The angle of the vector (x, y) in radians, in (-pi, pi], within 4 ulp; 0 for the zero vector.
double DeterministicAtan2(double y, double x);

// The nearest integer of a number above -0.5, in one instruction on every processor. std::lround() calls the C library.
template <typename Real>
int RoundNonNegative(Real value) {
  return static_cast<int>(value + Real{0.5});  // NOLINT(bugprone-incorrect-roundings): see above
}

}  // namespace evpose
