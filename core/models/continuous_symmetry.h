// SPDX-License-Identifier: Apache-2.0

// Continuous symmetries of an object: rotations about an axis or about a centre by any angle
// (core/models/README.md, section 4).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// Finds the continuous symmetry of a model from its surface, lines and curves; nullopt if it has none, or no triangle.
// An object that is nearly symmetric, as a shaft with a keyway, has none and gets a notice (`notices` may be null). The
// time is proportional to n log n for n triangles, lines and points of curves.
std::optional<ContinuousSymmetry> FindContinuousSymmetry(const ObjectModel& model, std::vector<std::string>* notices);

// Tangents of a pose along which it moves through equivalent poses: one column for an axis, three for a sphere.
using FreeDirections = Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, 3>;
// Returns them for a pose camera_from_object, in the order [translation, rotation] of rigid_transform.h, for a rotation
// by 1 rad (core/models/README.md, equation (8)).
FreeDirections FreeDirectionsAt(const ContinuousSymmetry& symmetry, const RigidTransform& camera_from_object);

// Returns the rigid motion object_from_object that turns an object about the symmetry's centre.
RigidTransform AboutCentre(const ContinuousSymmetry& symmetry, const Eigen::Matrix3d& rotation);

// Returns the equivalent pose camera_from_object * S, S a motion of the group, whose rotation is nearest to that of the
// reference. For an axis this is the pose without spin relative to the reference (core/models/README.md, equation (7));
// of the two turned over against each other, the first is taken if they are equally near.
RigidTransform NearestEquivalent(const RigidTransform& camera_from_object, const ContinuousSymmetry& symmetry,
                                 const RigidTransform& reference);
// The same without the half turns that turn the axis over.
RigidTransform NearestWithoutFlip(const RigidTransform& camera_from_object, const ContinuousSymmetry& symmetry,
                                  const RigidTransform& reference);
// Returns the nearest equivalent pose by the continuous or the discrete symmetries (symmetry.h) of the model.
RigidTransform NearestEquivalent(const RigidTransform& camera_from_object, const ObjectModel& model,
                                 const RigidTransform& reference);

}  // namespace evpose
