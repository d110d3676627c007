// SPDX-License-Identifier: Apache-2.0

// Prior of the pose for the baselines that require one.
#pragma once

#include "core/geometry/rigid_transform.h"
#include "core/numerics/random.h"

namespace evpose {

// A pose with one standard deviation of each component.
struct PosePrior {
  RigidTransform camera_from_object;
  double rotation_rad = 0.0;       // radians, of each component of the axis-angle vector
  double translation_ratio = 0.0;  // standard deviation of each coordinate, relative to the depth

  // Draws a pose. The offset has the components of Perturb().
  RigidTransform Draw(Random& random) const {
    const double depth_m = camera_from_object.translation_m.z();
    Vector6d offset;
    for (int i = 0; i < 3; ++i) offset[i] = translation_ratio * depth_m * random.Normal();
    for (int i = 3; i < 6; ++i) offset[i] = rotation_rad * random.Normal();
    return Perturb(camera_from_object, offset);
  }
};

}  // namespace evpose
