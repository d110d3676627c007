// SPDX-License-Identifier: Apache-2.0

// The rigid motions that map an object onto itself (core/models/README.md, section 2).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// Counts of the operations of one search.
struct SymmetryWork {
  int64_t line_comparisons = 0;      // searches for the image of one line or point of a ring: at most 5 million
  int64_t rotation_comparisons = 0;  // with rotations of the group, or copies of them: at most 20 million, and one test
  int64_t surface_samples = 0;       // searches for the image of one point of the surface: at most 1 million
};

// Returns the proper rotations (no reflections) about axes through the model's centre that map every line onto a line,
// every curve onto a curve and every face onto a face: object_from_object, the identity first. They form a group. A
// cube has 24, a cuboid 4, most objects 1, a prism as many as its number of sides allows. Points closer than
// `tolerance_ratio` of the diameter are the same; lines are the same only if the normals of their faces match. The
// division of a surface into triangles and of an edge into lines has no effect. If all lines, and the axes of all
// rings, lie on one axis through the centre, only rotations about this axis and half turns across it are found (README,
// section 2). Of a model without lines and curves, the surface decides (FindSurfaceGroup). Of a model with a continuous
// symmetry, none are searched for, and the result is empty. The work is bounded (8192 lines and curves, 4096
// symmetries, and each count of SymmetryWork). At the bound, the result is the group found so far, and `notices`,
// unless null, gets a notice. `work`, unless null, gets what was counted.
std::vector<RigidTransform> FindSymmetries(const ObjectModel& model, double tolerance_ratio = 1e-3,
                                           std::vector<std::string>* notices = nullptr, SymmetryWork* work = nullptr);

// Returns the equivalent pose camera_from_object * S, S one of the discrete `symmetries`, whose rotation is nearest to
// that of the reference; if several are, the first of them in the order of `symmetries`. Without symmetries, returns
// the pose itself.
RigidTransform NearestEquivalent(const RigidTransform& camera_from_object, absl::Span<const RigidTransform> symmetries,
                                 const RigidTransform& reference);

}  // namespace evpose
