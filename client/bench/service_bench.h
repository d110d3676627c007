// SPDX-License-Identifier: Apache-2.0

// How fast a recording comes through a server: transport, the whole path, latency, many sessions, memory.
#pragma once

#include <sys/types.h>

#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/bench/speed_row.h"
#include "client/cli/common/command.h"
#include "core/experiments/speed/speed_bench.h"

namespace evpose::client {

struct ServiceBenchOptions {
  std::vector<std::string> parts;  // some of ServiceParts()
  int64_t duration_us = 200'000;   // length of each recording
  int num_repetitions = 7;
  ServerArguments server;  // without an address, the benchmark starts a server process
  pid_t server_pid = 0;    // process of `server` on this machine; 0 if it is unknown
};

// "transport", "path", "latency", "sessions", "memory".
const std::vector<std::string>& ServiceParts();

// Calls `on_row` after each measurement, and `on_progress` as RunSpeedBench does. Errors: those of connecting to a
// server, of starting one, and of sessions; INVALID_ARGUMENT (usage) for parts that cannot be measured with the server
// given; CANCELLED.
absl::Status RunServiceBench(const ServiceBenchOptions& options, CliContext& context,
                             const std::function<void(const ServiceRow&)>& on_row, const SpeedProgress& on_progress);

}  // namespace evpose::client
