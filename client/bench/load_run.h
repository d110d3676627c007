// SPDX-License-Identifier: Apache-2.0

// A load test: many sessions at the pace of their sensors, from one thread.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "client/bench/load_counts.h"
#include "client/bench/load_recording.h"
#include "evpose/client.h"
#include "evpose/track.h"

namespace evpose::client {

struct LoadOptions {
  std::string addresses;  // as for Client::Connect()
  ClientOptions client;
  SessionConfig config;           // of every session
  int sessions = 1;               // at a time
  double minutes = 1.0;           // from the time at which every session was created or refused
  double churn_per_minute = 0.0;  // sessions that end and are replaced by new ones
  int watchers = 0;               // of all sessions together
  double watch_hz = 30.0;         // most poses per second that a watcher asks for
  // Called when every session was created or refused, and at the end of the test. If they start work in another thread,
  // the sessions continue without being measured until is_read() returns true, at most 30 s.
  std::function<void()> on_begin, on_end;
  std::function<bool()> is_read;  // empty: such work is not waited for
  // The start fails when no session has been created or refused for this time.
  absl::Duration max_outage = RetryOptions().max_outage;
};

struct LoadResult {
  LoadCounts counts;     // of the whole run; the numbers of events and poses are those of the test
  double seconds = 0.0;  // of the test: without the start, and without the end of the sessions
  double cpu_s = 0.0;    // processor time of this process in that time
  // Delay of this process's actions after their nominal times: 99th percentile and maximum.
  int64_t late_p99_us = 0;
  int64_t late_max_us = 0;
};

// Errors: those of the addresses and of the TLS files; CANCELLED if `on_progress`, which is called once per second with
// the finished share, returns false before all sessions were created or refused; later, that ends the test early.
// UNAVAILABLE if sessions are neither created nor refused for LoadOptions::max_outage.
absl::StatusOr<LoadResult> RunLoad(const LoadOptions& options, const LoadRecording& recording,
                                   const std::function<bool(double ratio, const LoadCounts& counts)>& on_progress);

}  // namespace evpose::client
