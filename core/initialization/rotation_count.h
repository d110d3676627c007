// SPDX-License-Identifier: Apache-2.0

// The number of image lines that a rotation explains (the objective of the published initialisation), and the
// symmetries under which it is invariant.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/types/span.h"
#include "core/models/object_model.h"

namespace evpose {

// Returns the unit directions of the model's lines without duplicates, in the order of the lines: v and -v are equal,
// and the first of several directions closer than `tolerance_rad` represents all of them. A cube has three directions.
std::vector<Eigen::Vector3d> UniqueDirections(const ObjectModel& model, double tolerance_rad = 1e-3);

// The group of proper rotations Q that map a set of unit directions, up to sign, onto itself; the identity comes first.
// Three orthogonal directions have 24, two orthogonal directions have 8. Q maps each direction to within
// `tolerance_rad` of a direction of the set.
std::vector<Eigen::Matrix3d> DirectionSymmetries(absl::Span<const Eigen::Vector3d> directions,
                                                 double tolerance_rad = 1e-4);

// The subgroup of Q that maps each direction to itself or to its opposite. A box has four elements: even with known
// correspondences its directions are consistent with four rotations.
std::vector<Eigen::Matrix3d> SignSymmetries(absl::Span<const Eigen::Vector3d> directions, double tolerance_rad = 1e-4);

// The largest error of the group's elements, in radians, in mapping the set onto itself.
double SymmetryDeviation(absl::Span<const Eigen::Vector3d> directions, absl::Span<const Eigen::Matrix3d> symmetries);

// E(R) = sum_j max_k [ |angle(n_j, R v_k) - pi/2| <= inlier_rad ] (LOPET, eq. (eq1-2)): the number of normals that are
// perpendicular to a rotated direction. All vectors have unit length.
int CountPerpendicular(absl::Span<const Eigen::Vector3d> normals, absl::Span<const Eigen::Vector3d> directions,
                       const Eigen::Matrix3d& rotation, double inlier_rad);

}  // namespace evpose
