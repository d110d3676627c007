// SPDX-License-Identifier: Apache-2.0

// The motion of an object with a continuous symmetry along that symmetry, which no event measures
// (core/estimation/README.md, section 9). Without a symmetry these functions do nothing.
#pragma once

#include <optional>

#include "core/geometry/motion_prior.h"
#include "core/models/object_model.h"

namespace evpose {

// Removes the spin along the symmetry from the twist of a predicted state, and nearly all uncertainty along it from the
// covariance of pose and twist, so that a fit to the prediction neither moves along it nor spins. The covariance stays
// positive definite.
void RemoveFreeMotion(const std::optional<ContinuousSymmetry>& symmetry, MotionState& state);
// Does so for an estimated state, and replaces its pose by the equivalent pose that has no spin relative to `before`.
void RemoveFreeMotion(const std::optional<ContinuousSymmetry>& symmetry, const MotionState& before, MotionState& state);

// Variance, rad^2, of an angle that may have any value, uniformly distributed over one turn: pi^2 / 3.
inline constexpr double kFreeAngleVarianceRad2 = 3.289868133696453;
// Returns the covariance for a report: that of the pose without the motion along the symmetry, plus
// kFreeAngleVarianceRad2 along each free direction. Positive definite if `covariance` is.
Matrix6d WithFreeAngle(const std::optional<ContinuousSymmetry>& symmetry, const RigidTransform& camera_from_object,
                       const Matrix6d& covariance);

}  // namespace evpose
