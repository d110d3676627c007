// SPDX-License-Identifier: Apache-2.0

// Prisms and frustums of cones as OBJ files, for tests.
#pragma once

#include <cmath>
#include <numbers>
#include <string>

#include "absl/strings/str_format.h"

namespace evpose {

// Returns an OBJ file in millimetres. Its ends are regular polygons with `sides` corners on circles of these radii.
inline std::string FrustumObj(int sides, double low_radius_mm, double high_radius_mm, double height_mm) {
  std::string obj, low = "f", high = "f";
  for (int i = 0; i < sides; ++i) {
    const double x = std::cos(2.0 * std::numbers::pi * i / sides), y = std::sin(2.0 * std::numbers::pi * i / sides);
    absl::StrAppendFormat(&obj, "v %.6f %.6f %.6f\nv %.6f %.6f %.6f\n", low_radius_mm * x, low_radius_mm * y, 0.0,
                          high_radius_mm * x, high_radius_mm * y, height_mm);
  }
  for (int i = 0; i < sides; ++i) {
    const int next = (i + 1) % sides;
    absl::StrAppendFormat(&obj, "f %d %d %d %d\n", 2 * i + 1, 2 * next + 1, 2 * next + 2, 2 * i + 2);
    absl::StrAppendFormat(&low, " %d", 2 * (sides - 1 - i) + 1);
    absl::StrAppendFormat(&high, " %d", 2 * i + 2);
  }
  return obj + low + "\n" + high + "\n";
}

}  // namespace evpose
