// SPDX-License-Identifier: Apache-2.0

// Elementary functions that give the same bits on every machine. The C library's own choose between variants by
// processor and differ in the last bit; a session's poses must not (design: a session is a function of its bytes).
// Everything between the decoder and a pose uses these; sqrt and the four operations are exact by IEEE 754 anyway.
#pragma once

#include <numbers>

namespace evpose {

inline constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;

// e^x; within 2 ulp for x in [-708, 709], 0 below, +infinity above.
double DeterministicExp(double x);

struct SinCos {
  double sin;
  double cos;
};
// Angle in radians, |angle| <= 1e5; absolute error below 1e-15 times max(1, |angle|).
SinCos DeterministicSinCos(double angle_rad);

// The angle of (x, y) in (-pi, pi], radians; within 4 ulp. 0 for the origin.
double DeterministicAtan2(double y, double x);

}  // namespace evpose
