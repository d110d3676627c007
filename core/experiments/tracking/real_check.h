// SPDX-License-Identifier: Apache-2.0

// Whether the results on recordings of real sensors are those that `evpose bench real --check` requires.
#pragma once

#include "absl/status/status.h"
#include "core/experiments/tracking/real_bench.h"

namespace evpose {

struct RealLimits {
  // Longest time for which TRACKING may be reported with a wrong pose of an object that moves, seconds: until the tests
  // of a pose that is wrong have been significant. An object at rest has no events that could prefer a wrong pose, so
  // that TRACKING is never reported with one.
  double max_wrong_s = 0.03;
  // Least share of the starts without a prior from which the object is found, with a right first pose. Below 1, because
  // a start may lie in a part in which the object hardly moves.
  double min_found_ratio = 0.95;
  // Least share of the time with a right pose, in any state, of the runs from the reference pose.
  double min_right_ratio = 0.95;
  // Motion in the image, pixels, above which the object moves in a run: that of a pose that is wrong, because the
  // reference of an object at rest has errors, too.
  double min_motion_px = 3.0;
};

// Error: FAILED_PRECONDITION with the first limit that the runs of a recording exceed. Runs in which the object is at
// rest count for wrong poses only.
absl::Status CheckRealRow(const RealBenchRow& row, const RealLimits& limits);
// Error: FAILED_PRECONDITION if TRACKING was reported.
absl::Status CheckForeignRow(const ForeignBenchRow& row);

}  // namespace evpose
