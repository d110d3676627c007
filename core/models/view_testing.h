// SPDX-License-Identifier: Apache-2.0

// Views of a model, for tests.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "core/geometry/rigid_transform.h"

namespace evpose {

// The camera is at `eye` (object frame) and looks at `target`. The axes of the image are parallel to no axis of the
// object.
inline RigidTransform ViewFrom(const Eigen::Vector3d& eye, const Eigen::Vector3d& target = Eigen::Vector3d::Zero()) {
  const Eigen::Vector3d z = (target - eye).normalized();
  const Eigen::Vector3d x = z.cross(Eigen::Vector3d(0.1, 1.0, 0.05)).normalized();
  RigidTransform pose;
  pose.rotation.row(0) = x;
  pose.rotation.row(1) = z.cross(x);
  pose.rotation.row(2) = z;
  pose.translation_m = -(pose.rotation * eye);
  return pose;
}

}  // namespace evpose
