// SPDX-License-Identifier: Apache-2.0

// Directions that are spread evenly over the sphere.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <numbers>

#include "core/numerics/math.h"

namespace evpose {

// The unit vector with the coordinate `z` on a Fibonacci spiral: the longitude grows by the golden angle from each
// number to the next. With `z` at equal steps in (-1, 1) the directions are spread evenly over the sphere, in (0, 1)
// over a half of it.
inline Eigen::Vector3d SpiralDirection(int number, double z) {
  const auto [sin, cos] = DeterministicSinCos(number * std::numbers::pi * (3.0 - std::sqrt(5.0)));
  const double radius = std::sqrt(1.0 - z * z);
  return {radius * cos, radius * sin, z};
}

}  // namespace evpose
