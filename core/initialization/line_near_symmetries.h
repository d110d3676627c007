// SPDX-License-Identifier: Apache-2.0

// Near-symmetries: rigid motions that map most, but not all, of the object's lines onto lines. A search can confuse
// poses that differ by such a motion.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// Finds, for each of `rotations` except the identity, the shift that aligns the largest length of the rotated lines
// with lines; it is a near-symmetry if this is at least half of their length. `radius_m` is half the object's size. Two
// lines closer than 2 % of it coincide, which is about the resolution of an image. Returns object_from_object, the
// motion that aligns the largest length first, at most seven. A rotation with several such shifts yields one of them.
// Time: number of rotations times the square of the number of lines.
std::vector<RigidTransform> FindLineNearSymmetries(absl::Span<const ModelLine> lines,
                                                   absl::Span<const Eigen::Matrix3d> rotations, double radius_m);

}  // namespace evpose
