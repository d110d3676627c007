// SPDX-License-Identifier: Apache-2.0

// Directions of edges in the image, modulo a half turn, as numbers.
#pragma once

#include <algorithm>
#include <cmath>

namespace evpose {

// Bins of 15 degrees: fine enough to separate the edges of a rounded corner, and wider than the error of a direction
// from a few events.
inline constexpr int kOrientationBins = 12;

// The bin of a direction: 0 contains the angles [0, 15) degrees from the u axis towards the v axis. Without elementary
// functions.
inline int OrientationBin(double du, double dv) {
  // Tangents of 15, 30, 45, 60 and 75 degrees.
  constexpr double kTangents[] = {0.26794919243112270, 0.57735026918962576, 1.0, 1.7320508075688773,
                                  3.7320508075688773};
  const double across = std::abs(dv), along = std::abs(du);
  int bin = 0;
  for (const double tangent : kTangents) bin += across >= tangent * along ? 1 : 0;
  const bool is_falling = (du < 0.0) != (dv < 0.0) && across > 0.0;
  return is_falling ? kOrientationBins - 1 - bin : bin;
}

}  // namespace evpose
