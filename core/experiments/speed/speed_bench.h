// SPDX-License-Identifier: Apache-2.0

// How long decoding, tracking and the search for a first pose take, on recordings of the project's simulator. Times are
// of one thread, and the least of several repetitions: other programs on the machine only ever add to them.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "core/experiments/speed/speed_recordings.h"

namespace evpose {

struct SpeedBenchOptions {
  std::vector<std::string> parts;  // names of SpeedParts(); empty: all
  int64_t duration_us = 200'000;   // of each recording, [10'000, 10'000'000]
  int num_repetitions = 7;         // [1, 1000]

  // INVALID_ARGUMENT naming the field, or listing the known parts.
  absl::Status Validate() const;
};

// "decode", "windows", "associate", "estimate", "track", "initialize".
const std::vector<std::string>& SpeedParts();

// One measurement.
struct SpeedRow {
  std::string part;
  std::string what;                    // the encoding, "lines x1" or "lines x16"; otherwise as the part
  std::string scene;                   // SpeedScene::name
  double rate_mev_per_s = 0.0;         // of the recording, by the sensor's clock
  uint64_t num_events = 0;             // estimate: those that the estimator is given
  uint64_t num_bytes = 0;              // decode
  double seconds = 0.0;                // processor time of one thread, the least
  std::optional<double> memcpy_ratio;  // decode: to the time of copying the same bytes, whole, measured alternately
  uint64_t num_poses = 0;              // track
  int num_lines = 0;                   // track: of the model
  // associate and estimate: windows, and the lines that each had, summed up.
  uint64_t num_windows = 0;
  uint64_t num_window_lines = 0;
  // The same: to "lines x1".
  std::optional<double> lines_ratio;
  std::optional<double> cost_ratio;
  double sensor_seconds = 0.0;  // that `seconds` went through; initialize: until the first pose

  double NsPerEvent() const { return 1e9 * seconds / static_cast<double>(num_events); }
  double MevPerS() const { return 1e-6 * static_cast<double>(num_events) / seconds; }
  // Of a line in a window; infinite where lines were not counted.
  double NsPerLine() const { return 1e9 * seconds / static_cast<double>(num_window_lines); }
  // Below one: faster than the sensor.
  double RealTimeRatio() const { return seconds / sensor_seconds; }
};

// Told how much is done, [0, 1], and what is being done; returning false ends it, with CANCELLED. May be null.
using SpeedProgress = std::function<bool(double done_ratio, const std::string& text)>;

// `on_row` is told of every row when it is measured. Errors: as Validate(); CANCELLED; INTERNAL when a recording does
// not come back from its bytes, or the tracker has no pose of it.
absl::Status RunSpeedBench(const SpeedBenchOptions& options, const std::function<void(const SpeedRow&)>& on_row,
                           const SpeedProgress& on_progress = nullptr);

}  // namespace evpose
