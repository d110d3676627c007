// SPDX-License-Identifier: Apache-2.0

// Benchmark of decoding, tracking and the search for a first pose, on recordings of the simulator of this project.
// Times are processor times of one thread, the minimum of several repetitions, because other programs on the machine
// only increase them.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "core/experiments/speed/speed_recordings.h"

namespace evpose {

// The defaults are settings of the benchmark and not tuned. The fastest of seven repetitions is reported, which other
// programs on the machine change least.
struct SpeedBenchOptions {
  std::vector<std::string> parts;  // names of SpeedParts(); empty: all
  int64_t duration_us = 200'000;   // microseconds of each recording, [10'000, 10'000'000]
  int num_repetitions = 7;         // [1, 1000]

  // INVALID_ARGUMENT names the field or lists the known parts.
  absl::Status Validate() const;
};

// "decode", "windows", "associate", "estimate", "track", "initialize".
const std::vector<std::string>& SpeedParts();

// One measurement.
struct SpeedRow {
  std::string part;
  std::string what;             // the encoding; "lines x1" or "lines x16"; otherwise equal to `part`
  std::string scene;            // SpeedScene::name
  double rate_mev_per_s = 0.0;  // rate of the recording, million events per second of sensor time
  uint64_t num_events = 0;      // estimate: events passed to the estimator
  uint64_t num_bytes = 0;       // decode
  double seconds = 0.0;         // processor time of one thread, the minimum
  // Decode: relative to the time of copying the same bytes, measured alternately.
  std::optional<double> memcpy_ratio;
  uint64_t num_poses = 0;  // track
  int num_lines = 0;       // track: lines of the model
  // associate and estimate: number of windows, and the sum of their lines.
  uint64_t num_windows = 0;
  uint64_t num_window_lines = 0;
  // The same: number of lines and time relative to "lines x1".
  std::optional<double> lines_ratio;
  std::optional<double> cost_ratio;
  double sensor_seconds = 0.0;  // sensor time processed in `seconds`; initialize: until the first pose

  double NsPerEvent() const { return 1e9 * seconds / static_cast<double>(num_events); }
  double MevPerS() const { return 1e-6 * static_cast<double>(num_events) / seconds; }
  // Nanoseconds per line of a window; infinite if lines were not counted.
  double NsPerLine() const { return 1e9 * seconds / static_cast<double>(num_window_lines); }
  // Processing time over sensor time; below one if processing is faster than the sensor.
  double RealTimeRatio() const { return seconds / sensor_seconds; }
};

// Called with the finished share of the work, in [0, 1], and a description of the present step; returning false ends
// the work with CANCELLED. May be null.
using SpeedProgress = std::function<bool(double done_ratio, const std::string& text)>;

// The progress of work in steps that count alike.
class StepProgress {
 public:
  StepProgress(size_t num_steps, const SpeedProgress& on_progress) : num_steps_(num_steps), on_progress_(on_progress) {}
  // Reports the share of the present step, in [0, 1]. Returns false if the work has to end.
  bool Show(double step_ratio, const std::string& text) const {
    if (!on_progress_) return true;
    return on_progress_((static_cast<double>(num_done_) + step_ratio) / static_cast<double>(num_steps_), text);
  }
  void FinishStep() { ++num_done_; }

 private:
  const size_t num_steps_;
  const SpeedProgress& on_progress_;
  size_t num_done_ = 0;
};

// Runs the benchmark; `on_row` is called after each measurement. Errors: those of Validate(); CANCELLED; INTERNAL if a
// recording does not decode to its events or the tracker has no pose of it.
absl::Status RunSpeedBench(const SpeedBenchOptions& options, const std::function<void(const SpeedRow&)>& on_row,
                           const SpeedProgress& on_progress = nullptr);

}  // namespace evpose
