// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/real_check.h"

#include <vector>

#include "absl/strings/str_format.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

std::vector<RealRun> MovingRuns(const std::vector<RealRun>& runs, double min_motion_px) {
  std::vector<RealRun> moving;
  for (const RealRun& run : runs) {
    if (run.motion_px > min_motion_px) moving.push_back(run);
  }
  return moving;
}

absl::Status CheckWrongTime(const std::string& recording, const RealRun& run, const RealLimits& limits) {
  const bool is_moving = run.motion_px > limits.min_motion_px;
  const double max_wrong_s = is_moving ? limits.max_wrong_s : 0.0;
  if (run.longest_wrong_s <= max_wrong_s) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrFormat(
      "%s, run from %.3f s: TRACKING is reported with a wrong pose for %.0f ms; at most %.0f ms are permitted for an "
      "object %s",
      recording, 1e-6 * static_cast<double>(run.start_us), 1e3 * run.longest_wrong_s, 1e3 * max_wrong_s,
      is_moving ? "that moves" : "at rest"));
}

}  // namespace

absl::Status CheckRealRow(const RealBenchRow& row, const RealLimits& limits) {
  for (const std::vector<RealRun>* runs : {&row.searched, &row.given}) {
    for (const RealRun& run : *runs) EVPOSE_RETURN_IF_ERROR(CheckWrongTime(row.recording, run, limits));
  }
  const std::vector<RealRun> searched = MovingRuns(row.searched, limits.min_motion_px);
  const RealSummary summary = SummariseRealRuns(searched);
  const int num_right = summary.num_found - summary.num_wrong;
  if (num_right < limits.min_found_ratio * static_cast<double>(searched.size())) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "%s is found with a right first pose in %d of the %d starts in which it moves; at least %.0f %% are required",
        row.recording, num_right, searched.size(), 100.0 * limits.min_found_ratio));
  }
  const std::vector<RealRun> given = MovingRuns(row.given, limits.min_motion_px);
  const double right_ratio = SummariseRealRuns(given).right_ratio;
  if (given.empty() || right_ratio >= limits.min_right_ratio) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrFormat(
      "%s has a right pose for %.1f %% of the time from the reference pose on; at least %.0f %% are required",
      row.recording, 100.0 * right_ratio, 100.0 * limits.min_right_ratio));
}

absl::Status CheckForeignRow(const ForeignBenchRow& row) {
  if (!row.run.is_found()) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrFormat("%s is TRACKING in %s, which does not show it", row.object, row.recording));
}

}  // namespace evpose
