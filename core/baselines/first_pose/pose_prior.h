// SPDX-License-Identifier: Apache-2.0

// What the baselines that need a first guess are told of the pose.
#pragma once

#include "core/geometry/rigid_transform.h"
#include "core/numerics/random.h"

namespace evpose {

// A pose and how far it may be off, one standard deviation each.
struct PosePrior {
  RigidTransform camera_from_object;
  double rotation_rad = 0.0;       // of each component of the axis-angle vector
  double translation_ratio = 0.0;  // of each coordinate, of the depth

  // A pose drawn from it. An offset has the components of Perturb().
  RigidTransform Draw(Random& random) const {
    const double depth_m = camera_from_object.translation_m.z();
    Vector6d offset;
    for (int i = 0; i < 3; ++i) offset[i] = translation_ratio * depth_m * random.Normal();
    for (int i = 3; i < 6; ++i) offset[i] = rotation_rad * random.Normal();
    return Perturb(camera_from_object, offset);
  }
};

}  // namespace evpose
