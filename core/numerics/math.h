// SPDX-License-Identifier: Apache-2.0

// Elementary functions that give the same bits on every machine (core/numerics/README.md, section 1). Those of the C
// library have a variant for each kind of processor, which differ in the last bit. All code between the decoder and a
// pose uses these functions. sqrt and the four operations need none: IEEE 754 requires them to be rounded correctly.
#pragma once

#include <numbers>

namespace evpose {

inline constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;

// e^x, within 2 ulp for x in [-708, 709]; 0 below, +infinity above, NaN for NaN.
double DeterministicExp(double x);

struct SinCos {
  double sin;
  double cos;
};
// Sine and cosine of an angle in radians, |angle| <= 1e5, with an absolute error below 1e-15 max(1, |angle|).
SinCos DeterministicSinCos(double angle_rad);

// The angle of the vector (x, y) in radians, in (-pi, pi], within 4 ulp; 0 for the zero vector.
double DeterministicAtan2(double y, double x);

}  // namespace evpose
