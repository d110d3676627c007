// SPDX-License-Identifier: Apache-2.0

// The directions of the lines of a model, and the rotations that map them onto each other.
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

}  // namespace evpose
