// SPDX-License-Identifier: Apache-2.0

// Which motions of an object the events of its lines measure (core/association/README.md, section 7).
#pragma once

#include <Eigen/Core>

#include "core/association/association.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"

namespace evpose {

// Columns: the motions that move an outline of this radius about `centre` (object frame) by about 1 px, as tangents of
// the pose: translations across, depth, and rotations about the centre.
Matrix6d OutlineMotions(const CameraModel& camera, const RigidTransform& camera_from_object,
                        const Eigen::Vector3d& centre, double radius_m);

// Returns the axes of the rotations that do not change the image of a model with a continuous symmetry, camera frame;
// no column without one.
Eigen::Matrix3Xd FreeRotations(const ObjectModel& model, const Eigen::Matrix3d& rotation);

// Adds equation (14): the information of `events` events of a line, each with a standard deviation of 1 px across it,
// about `motions`. Only the middle of an element of a curve counts: the derivative of its ends contains that the chord
// turns while the curve moves along itself, which no event shows. Requires line.in_view().
void AddInformation(const CameraModel& camera, const ImageLine& line, double events, const Matrix6d& motions,
                    Matrix6d& information);

// Whether every motion except the free rotations is known with a standard deviation below `max_deviation_px`, in the
// units of OutlineMotions(), and with more information than errors of the derivatives could cause.
bool IsDetermined(const Matrix6d& information, const Eigen::Matrix3Xd& free_rotations, double max_deviation_px);

// Whether, for every motion but the free rotations, `part` has at least this share of the information of `whole`.
// Motions about which `whole` has less than 1e-6 of its trace do not count.
bool IsAtLeast(const Matrix6d& part, double share, const Matrix6d& whole, const Eigen::Matrix3Xd& free_rotations);

}  // namespace evpose
