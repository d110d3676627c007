// SPDX-License-Identifier: Apache-2.0

// A low-discrepancy sequence of points in a triangle (Roberts, "The unreasonable effectiveness of quasirandom
// sequences", 2018).
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace evpose {

// Returns u and v of the point a + u (b - a) + v (c - a) with the given index, from 0.
inline std::array<double, 2> TriangleSequence(size_t index) {
  constexpr double kStepU = 0.7548776662466927, kStepV = 0.5698402909980532;
  const double number = static_cast<double>(index) + 1.0;
  double u = number * kStepU - std::floor(number * kStepU), v = number * kStepV - std::floor(number * kStepV);
  if (u + v > 1.0) {
    u = 1.0 - u;
    v = 1.0 - v;
  }
  return {u, v};
}

}  // namespace evpose
