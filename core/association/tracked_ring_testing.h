// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <vector>

#include "core/association/association.h"

namespace evpose::testing {

// Returns a circle about the z axis of the object as `count` elements of one curve, in order of the angle from the x
// axis; lengths in metres.
inline std::vector<TrackedLine> TrackedRing(int count, double radius_m) {
  const auto corner = [=](int i) {
    const double angle = 2.0 * M_PI * i / count;
    return Eigen::Vector3d(radius_m * std::cos(angle), radius_m * std::sin(angle), 0.0);
  };
  std::vector<TrackedLine> ring(count);
  for (int k = 0; k < count; ++k) {
    ring[k].p1 = corner(k);
    ring[k].p2 = corner(k + 1);
    ring[k].is_element = true;
    ring[k].previous = (k + count - 1) % count;
    ring[k].next = (k + 1) % count;
  }
  return ring;
}

}  // namespace evpose::testing
