// SPDX-License-Identifier: Apache-2.0

// Writes the recorded commits of one session under many names.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "server/runtime/latency_histogram.h"
#include "server/stores/common/store.h"
#include "tests/bench/stores/commit_recording.h"

namespace evpose::server {

struct ReplayOptions {
  int sessions = 1;
  std::chrono::microseconds spread{0};   // the sessions begin one after the other within this time
  std::chrono::microseconds warm_up{0};  // of the last session: before the measurement, its log of poses fills
  std::chrono::microseconds idle{0};     // with all sessions and without commits, for the idle processor time
  bool deletes_sessions = true;          // at the end; false for tests
};

struct ReplayResult {
  double seconds = 0.0;    // of the measurement, at the end of which the first session has no commits left
  uint64_t commits = 0;    // that were due in this time and have succeeded
  uint64_t written = 0;    // commits that have succeeded in this time, whenever they were due
  uint64_t bytes = 0;      // of the latter
  uint64_t unwritten = 0;  // commits that were due in this time and were not begun by its end
  // From the time at which a commit was due until it was durable. The commits that were not begun have the time until
  // the end of the measurement.
  LatencyHistogram latency;
  int64_t max_latency_us = 0;
  uint64_t repeated = 0;                   // commits that ended with UNAVAILABLE, and were repeated
  std::map<std::string, uint64_t> errors;  // sessions that ended with another error, by code
  // Use of the store by its own report. Absent if it reports none.
  std::optional<double> idle_cores;
  std::optional<double> cores;
  std::optional<uint64_t> bytes_before;
  std::optional<uint64_t> bytes_after;  // at the end of the measurement
};

// Errors: INVALID_ARGUMENT if the recording is not longer than spread and warm_up; those of the store for the creation
// and the deletion of sessions.
absl::StatusOr<ReplayResult> Replay(Store& store, const SessionRecording& recording, const ReplayOptions& options);

}  // namespace evpose::server
