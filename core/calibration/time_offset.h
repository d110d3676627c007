// SPDX-License-Identifier: Apache-2.0

// Candidates for the offset between the clocks of two trajectories of the same motion
// (core/calibration/README.md, section 7).
#pragma once

#include <cstdint>
#include <vector>

#include "core/geometry/trajectory.h"

namespace evpose {

struct OffsetCandidate {
  double offset_s = 0.0;  // clock of the reference minus that of the estimate
  double correlation = 0.0;
};

// Two successive samples of a trajectory have a gap between them, which is not interpolated, if they are farther apart
// than this multiple of the median interval.
inline constexpr int64_t kGapIntervals = 5;
int64_t MedianIntervalUs(const Trajectory& trajectory);

// The offsets at which the speeds of both trajectories agree best, the best one first, at most `max_count`. The speed
// is the angle of the rotation within a fixed time, which does not depend on the frames of either trajectory; for
// trajectories without rotation the distance. Empty if they never overlap by half of the shorter one.
std::vector<OffsetCandidate> FindTimeOffsets(const Trajectory& estimate, const Trajectory& reference, int max_count);

}  // namespace evpose
