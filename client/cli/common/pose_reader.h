// SPDX-License-Identifier: Apache-2.0

// Poses back from the files that PoseFile writes.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "core/geometry/trajectory.h"

namespace evpose::client {

struct ReadPoses {
  Trajectory trajectory;
  std::vector<Matrix6d> covariances;  // as many, or none: TUM has none
};

// A .csv by its header: t_us, tx_m to tz_m, qx to qw and, when all of them are there, cov_tx_tx to cov_rz_rz, in any
// order and among others. Anything else is TUM. Times must increase. Errors name path and line: those of
// ReadTumTrajectory(); INVALID_ARGUMENT also for a column that is missing, or poses of several objects.
absl::StatusOr<ReadPoses> ReadPoseFile(const std::string& path);
absl::StatusOr<ReadPoses> ParsePoseCsv(absl::string_view text, const std::string& name_for_errors);

}  // namespace evpose::client
