// SPDX-License-Identifier: Apache-2.0

// How many image lines a rotation explains: the objective of the published initialisation, and what it is blind to.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/types/span.h"
#include "core/models/object_model.h"

namespace evpose {

// Unit directions of the model's lines, each once: v and -v are the same, and so are directions closer than
// `tolerance_rad` (the first stands for all). In the order of the lines. A cube has three.
std::vector<Eigen::Vector3d> UniqueDirections(const ObjectModel& model, double tolerance_rad = 1e-3);

// The group of proper rotations Q under which a set of unit directions, taken without their signs, falls on itself;
// the identity first. Three directions at right angles have 24, two 8. The direction that Q maps v to is within
// `tolerance_rad` of a direction of the set.
std::vector<Eigen::Matrix3d> DirectionSymmetries(absl::Span<const Eigen::Vector3d> directions,
                                                 double tolerance_rad = 1e-4);

// Those of them under which each direction falls on itself or its opposite. A box has four: even with known
// correspondences its directions leave the choice between four rotations.
std::vector<Eigen::Matrix3d> SignSymmetries(absl::Span<const Eigen::Vector3d> directions, double tolerance_rad = 1e-4);

// Radians by which the group's worst element misses the set that it should map onto itself.
double SymmetryDeviation(absl::Span<const Eigen::Vector3d> directions, absl::Span<const Eigen::Matrix3d> symmetries);

// E(R) = sum_j max_k [ |angle(n_j, R v_k) - pi/2| <= inlier_rad ] (LOPET, eq. (eq1-2)): the number of normals that are
// perpendicular to a rotated direction. All vectors of unit length.
int CountPerpendicular(absl::Span<const Eigen::Vector3d> normals, absl::Span<const Eigen::Vector3d> directions,
                       const Eigen::Matrix3d& rotation, double inlier_rad);

}  // namespace evpose
