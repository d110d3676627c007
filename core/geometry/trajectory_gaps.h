// SPDX-License-Identifier: Apache-2.0

// Where the samples of a trajectory are missing, so that no pose is interpolated.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>

#include "absl/types/span.h"
#include "core/geometry/trajectory.h"

namespace evpose {

// Longest distance of two successive samples, microseconds, that the rate of the trajectory explains: three times the
// median distance, and at least 50 ms. Between samples that are farther apart, samples are missing.
int64_t LongestStepUs(const Trajectory& trajectory);
// Longest distance of two samples, microseconds, between which poses are interpolated: LongestStepUs(), but at most
// half a second, because an object may turn around meanwhile.
int64_t LongestInterpolatedStepUs(const Trajectory& trajectory);

// Returns the same as PoseNear() without `breaks`, except where the object was lost. `breaks` has the indices of the
// samples before which it was lost, in increasing order: between such a sample and its predecessor the result is
// nullopt.
std::optional<RigidTransform> PoseNear(const Trajectory& trajectory, int64_t t_us, int64_t max_gap_us,
                                       absl::Span<const size_t> breaks);

}  // namespace evpose
