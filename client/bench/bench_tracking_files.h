// SPDX-License-Identifier: Apache-2.0

// The results of `evpose bench tracking` for programs.
#pragma once

#include <string>
#include <vector>

#include "client/cli/common/command.h"
#include "core/experiments/tracking/tracking_bench.h"

namespace evpose::client {

// A header, and a line for each run of each row.
std::string TrackingCsv(const std::vector<TrackingBenchBlock>& blocks, int num_paths);

// The summaries with their verdicts, and the runs. What there is none of (no pose, no busy interval) is null.
Json TrackingJson(const std::vector<TrackingBenchBlock>& blocks, const TrackingBenchOptions& options);

}  // namespace evpose::client
