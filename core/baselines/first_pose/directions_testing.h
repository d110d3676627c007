// SPDX-License-Identifier: Apache-2.0

// Random directions for the tests of this folder.
#pragma once

#include <Eigen/Core>

#include "core/numerics/random.h"

namespace evpose {

// Unit vector, uniformly distributed over the sphere.
inline Eigen::Vector3d RandomUnit(Random& random) {
  return Eigen::Vector3d{random.Normal(), random.Normal(), random.Normal()}.normalized();
}

}  // namespace evpose
