// SPDX-License-Identifier: Apache-2.0

// The number of image lines that a rotation explains: the objective of the published initialisation.
#pragma once

#include <Eigen/Core>

#include "absl/types/span.h"

namespace evpose {

// E(R) = sum_j max_k [ |angle(n_j, R v_k) - pi/2| <= inlier_rad ] (LOPET, Sec. III-B, equation (2)): the number of
// normals that are perpendicular to a rotated direction. All vectors have unit length.
int CountPerpendicular(absl::Span<const Eigen::Vector3d> normals, absl::Span<const Eigen::Vector3d> directions,
                       const Eigen::Matrix3d& rotation, double inlier_rad);

}  // namespace evpose
