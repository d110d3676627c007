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
  std::vector<std::string> parts;  // of ServiceParts()
  int64_t duration_us = 200'000;   // of each recording
  int num_repetitions = 7;
  ServerArguments server;  // without an address: a process that it starts
  pid_t server_pid = 0;    // of that server, on this machine; 0: not known
};

// "transport", "path", "latency", "sessions", "memory".
const std::vector<std::string>& ServiceParts();

// `on_row` is told of every row when it is measured, `on_progress` as by RunSpeedBench. Errors: those of reaching or
// starting a server, and of sessions; INVALID_ARGUMENT (usage) for parts that need what a server somewhere else does
// not tell; CANCELLED.
absl::Status RunServiceBench(const ServiceBenchOptions& options, CliContext& context,
                             const std::function<void(const ServiceRow&)>& on_row, const SpeedProgress& on_progress);

}  // namespace evpose::client
