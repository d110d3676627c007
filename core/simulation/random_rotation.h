// SPDX-License-Identifier: Apache-2.0

// Random rotations of simulations and experiments.
#pragma once

#include <Eigen/Geometry>

#include "core/numerics/random.h"

namespace evpose {

// Draws uniformly from all rotations (Shoemake, "Uniform random rotations", Graphics Gems III, 1992).
inline Eigen::Matrix3d DrawRotation(Random& random) {
  Eigen::Vector4d q;
  do {
    for (int i = 0; i < 4; ++i) q[i] = random.Normal();
  } while (q.squaredNorm() < 1e-6);
  q.normalize();
  return Eigen::Quaterniond(q[3], q[0], q[1], q[2]).toRotationMatrix();
}

}  // namespace evpose
