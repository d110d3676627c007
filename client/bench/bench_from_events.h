// SPDX-License-Identifier: Apache-2.0

// evpose bench initialization --from-events: first poses from the events of simulated recordings.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/cli/common/command.h"

namespace evpose::client {

struct FromEventsArguments {
  int num_starts = 200;
  double duration_s = 5.0;
  double noise_ratio = 0.05;
  double speed_scale = 1.0;
  std::string camera = "evk4";
  std::string detector = "planes";
  int num_returns = 10;

  // Adds the options, which are valid only together with `from_events`.
  void AddTo(CLI::App& app, CLI::Option* from_events);
};

// `objects` are names; all objects if it is empty.
absl::Status RunFromEvents(const FromEventsArguments& arguments, const std::vector<std::string>& objects, uint64_t seed,
                           bool is_json, CliContext& context);

}  // namespace evpose::client
