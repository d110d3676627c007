// SPDX-License-Identifier: Apache-2.0

// The results of `evpose bench tracking` as CSV and JSON.
#pragma once

#include <string>
#include <vector>

#include "client/cli/common/command.h"
#include "core/experiments/tracking/tracking_bench.h"

namespace evpose::client {

// Returns a header and a line for each run of each row.
std::string TrackingCsv(const std::vector<TrackingBenchBlock>& blocks, int num_paths);

// Returns the summaries with the targets, and the runs. Values that do not exist (no pose, no busy interval) are null.
Json TrackingJson(const std::vector<TrackingBenchBlock>& blocks, const TrackingBenchOptions& options);

}  // namespace evpose::client
