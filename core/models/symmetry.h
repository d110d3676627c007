// The rigid motions that map an object onto itself.
#pragma once

#include <vector>

#include "absl/types/span.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// Proper rotations (no mirror images), each about an axis through the model's centre, under which every line falls on
// a line and every face on a face: object_from_object, the identity first, a group. A cube has 24, a cuboid 4, most
// objects 1. Points closer than `tolerance_ratio` of the diameter are the same.
std::vector<RigidTransform> FindSymmetries(const ObjectModel& model, double tolerance_ratio = 1e-3);

// Of the equivalent poses camera_from_object * S, the one whose rotation is nearest to the reference's; the first of
// them in the order of `symmetries` when several are. Without symmetries the pose itself.
RigidTransform NearestEquivalent(const RigidTransform& camera_from_object, absl::Span<const RigidTransform> symmetries,
                                 const RigidTransform& reference);

}  // namespace evpose
