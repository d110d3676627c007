// SPDX-License-Identifier: Apache-2.0

// The results of `evpose bench tracking` as text.
#pragma once

#include <ostream>

#include "core/experiments/tracking/tracking_bench.h"

namespace evpose::client {

// Explains the columns, for the help text.
extern const char kTrackingTableHelp[];

void PrintTrackingBlock(const TrackingBenchBlock& block, int num_paths, std::ostream& out);

}  // namespace evpose::client
