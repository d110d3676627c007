// SPDX-License-Identifier: Apache-2.0

// Motions after which an object looks nearly as before: by them a pose is mistaken for another.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// For each of `rotations` but the identity the shift that brings most of the lines' length onto lines, where that is
// the half of it or more: object_from_object, and about as good as an image tells lines apart. Lines that are nearer to
// each other than 2 % of `radius_m`, half the object's size, are the same. The best first, seven at most. What it finds
// is a suggestion: of several shifts for one rotation it gives one. Time: rotations times the square of the lines.
std::vector<RigidTransform> FindLookalikes(absl::Span<const ModelLine> lines,
                                           absl::Span<const Eigen::Matrix3d> rotations, double radius_m);

}  // namespace evpose
