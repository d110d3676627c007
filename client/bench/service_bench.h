// SPDX-License-Identifier: Apache-2.0

// How fast a recording comes through a server: transport, the whole path, latency, many sessions, memory.
#pragma once

#include <sys/types.h>

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/cli/common/command.h"
#include "core/experiments/speed/speed_bench.h"

namespace evpose::client {

struct NamedNumber {
  std::string name;  // with the unit; also the key in JSON
  double value = 0.0;
};

// A line of the table of `evpose bench speed`; each part has columns of its own.
struct ServiceRow {
  std::string part;
  std::string what;
  std::string scene;            // SpeedScene::name
  double rate_mev_per_s = 0.0;  // event rate of the recording in sensor time
  uint64_t num_events = 0;      // per session
  std::vector<NamedNumber> numbers;
  std::string measure;  // name of the number by which tests/bench/compare.py compares two tables
  bool more_is_better = false;
};

inline constexpr std::array<const char*, 5> kServiceParts = {"transport", "path", "latency", "sessions", "memory"};

struct ServiceBenchOptions {
  std::vector<std::string> parts;  // some of kServiceParts
  int64_t duration_us = 200'000;   // length of each recording
  int num_repetitions = 7;         // of each measurement, as of SpeedBenchOptions
  ServerArguments server;          // without an address, the benchmark starts a server process
  pid_t server_pid = 0;            // process of `server` on this machine; 0 if it is unknown
};

// Calls `on_row` after each measurement, and `on_progress` as RunSpeedBench does. Errors: those of connecting to a
// server, of starting one, and of sessions; INVALID_ARGUMENT (usage) for parts that cannot be measured with the server
// given; CANCELLED.
absl::Status RunServiceBench(const ServiceBenchOptions& options, CliContext& context,
                             const std::function<void(const ServiceRow&)>& on_row, const SpeedProgress& on_progress);

}  // namespace evpose::client
