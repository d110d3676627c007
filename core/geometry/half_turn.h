// SPDX-License-Identifier: Apache-2.0

// Half turns and reflections.
#pragma once

#include <Eigen/Core>

namespace evpose {

// The rotation by half a turn about a unit vector.
inline Eigen::Matrix3d HalfTurn(const Eigen::Vector3d& axis) {
  return 2.0 * axis * axis.transpose() - Eigen::Matrix3d::Identity();
}

// The reflection that reverses a unit vector.
inline Eigen::Matrix3d Reflection(const Eigen::Vector3d& unit) {
  return Eigen::Matrix3d::Identity() - 2.0 * unit * unit.transpose();
}

}  // namespace evpose
