// SPDX-License-Identifier: Apache-2.0

// The results of `evpose bench tracking` as text, CSV and JSON, and the poses and errors over time.
#pragma once

#include <ostream>
#include <string>
#include <vector>

#include "client/cli/common/command.h"
#include "core/experiments/tracking/tracking_bench.h"

namespace evpose::client {

// Explains the columns of the table, for the help text.
extern const char kTrackingTableHelp[];

void PrintTrackingBlock(const TrackingBenchBlock& block, int num_paths, std::ostream& out);

// Returns a header and a line for each run of each row.
std::string TrackingCsv(const std::vector<TrackingBenchBlock>& blocks, int num_paths);

// Returns the summaries with the targets, and the runs. Values that do not exist (no pose, no busy interval) are null.
Json TrackingJson(const std::vector<TrackingBenchBlock>& blocks, const TrackingBenchOptions& options);

// The first line of the file of traces, for tests/bench/plot.py, with the units in the names of the columns.
std::string TrackingTraceHeader();

// The first run of each estimator of the scenario, at most 1200 lines each: of each interval of time the first pose and
// the largest errors. Coordinates are camera_from_object; the rotation is the rotation vector relative to the first
// true pose, degrees. Of a symmetric object the equivalent pose nearest to the truth is written. The estimator "truth"
// has no errors.
std::string TrackingTraces(const TrackingBenchBlock& block);

}  // namespace evpose::client
