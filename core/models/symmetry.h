// SPDX-License-Identifier: Apache-2.0

// The rigid motions that map an object onto itself.
#pragma once

#include <string>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// Proper rotations (no mirror images), each about an axis through the model's centre, under which every line falls on
// a line and every face on a face: object_from_object, the identity first, a group. A cube has 24, a cuboid 4, most
// objects 1. Points closer than `tolerance_ratio` of the diameter are the same, and lines are only the same when the
// faces that they border on look the same way. How a surface is cut into triangles, or an edge into lines, does not
// matter. A prism of many sides has its many symmetries. Lines that all lie on one axis through the centre have, of
// infinitely many, the identity alone.
// The work is bounded: beyond it (8192 lines, 4096 symmetries, some seconds) those found so far, which are a group
// too, are the answer, and `notices`, unless null, says so.
std::vector<RigidTransform> FindSymmetries(const ObjectModel& model, double tolerance_ratio = 1e-3,
                                           std::vector<std::string>* notices = nullptr);

// Of the equivalent poses camera_from_object * S, the one whose rotation is nearest to the reference's; the first of
// them in the order of `symmetries` when several are. Without symmetries the pose itself.
RigidTransform NearestEquivalent(const RigidTransform& camera_from_object, absl::Span<const RigidTransform> symmetries,
                                 const RigidTransform& reference);

}  // namespace evpose
