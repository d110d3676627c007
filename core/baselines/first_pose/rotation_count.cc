// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/rotation_count.h"

#include <algorithm>
#include <cmath>

#include "core/numerics/math.h"

namespace evpose {

int CountPerpendicular(absl::Span<const Eigen::Vector3d> normals, absl::Span<const Eigen::Vector3d> directions,
                       const Eigen::Matrix3d& rotation, double inlier_rad) {
  // |angle - pi/2| <= eps is |n . R v| <= sin(eps) for eps < pi/2.
  const double max_cosine = DeterministicSinCos(inlier_rad).sin;
  int count = 0;
  for (const Eigen::Vector3d& normal : normals) {
    const Eigen::Vector3d turned = rotation.transpose() * normal;
    count += std::any_of(directions.begin(), directions.end(),
                         [&](const Eigen::Vector3d& v) { return std::abs(turned.dot(v)) <= max_cosine; });
  }
  return count;
}

}  // namespace evpose
