// SPDX-License-Identifier: Apache-2.0

// Poses and errors over time of `evpose bench tracking`, for tests/bench/plot.py.
#pragma once

#include <string>

#include "core/experiments/tracking/tracking_bench.h"

namespace evpose::client {

// The first line of the file, with the units in the names of the columns.
std::string TrackingTraceHeader();

// The first run of each estimator of the scenario, at most 1200 lines each: of each interval of time the first pose and
// the largest errors. Coordinates are camera_from_object; the rotation is the rotation vector relative to the first
// true pose, degrees. Of a symmetric object the equivalent pose nearest to the truth is written. The estimator "truth"
// has no errors.
std::string TrackingTraces(const TrackingBenchBlock& block);

}  // namespace evpose::client
