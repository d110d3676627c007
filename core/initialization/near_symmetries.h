// SPDX-License-Identifier: Apache-2.0

// Near symmetries: motions after which an object looks almost as before. A search can confuse the poses that differ by
// such a motion.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// For each of `rotations` except the identity: the shift that aligns the largest length of the lines with lines, if
// that is at least half of their length. Returns object_from_object, the best one first, at most seven. Two lines
// closer than 2 % of `radius_m`, half the object's size, coincide, which is about the resolution of an image. A
// rotation with several such shifts yields one of them. Time: number of rotations times the square of the number of
// lines.
std::vector<RigidTransform> FindLookalikes(absl::Span<const ModelLine> lines,
                                           absl::Span<const Eigen::Matrix3d> rotations, double radius_m);

}  // namespace evpose
