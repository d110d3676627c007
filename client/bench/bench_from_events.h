// SPDX-License-Identifier: Apache-2.0

// evpose bench initialization --from-events: first poses from the events of simulated recordings.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/cli/common/command.h"
#include "core/experiments/first_pose/event_trials.h"

namespace evpose::client {

struct FromEventsArguments {
  EventTrialOptions trial;  // without the object, the seed and the duration
  double duration_s = 5.0;
  int num_returns = 10;

  // Adds the options, which are valid only together with `from_events`.
  void AddTo(CLI::App& app, CLI::Option* from_events);
};

// `objects` are names; all objects if it is empty.
absl::Status RunFromEvents(const FromEventsArguments& arguments, const std::vector<std::string>& objects, uint64_t seed,
                           bool is_json, CliContext& context);

}  // namespace evpose::client
