// SPDX-License-Identifier: Apache-2.0

// evpose bench: compares evpose with published methods on simulated trials and recordings, and measures its speed,
// first poses and tracking on models and real recordings, and servers under load.
#include "client/bench/bench.h"

namespace evpose::client {

void AddBenchCommands(CLI::App& app, CliContext& context, CommandRunners& runners) {
  const auto add = [&](const char* name, const char* description, auto add_command) {
    CLI::App* command = app.add_subcommand(name, description);
    runners.emplace_back(command, add_command(*command, context));
  };
  add("initialization", "Compare first poses from lines, by evpose and by published methods",
      AddBenchInitializationCommand);
  add("load", "Load servers with many sessions at the pace of their sensors: losses, latencies, refusals, costs",
      AddBenchLoadCommand);
  add("models", "Measure the preparation of model files, and tracking on simulated recordings of them",
      AddBenchModelsCommand);
  add("real", "Measure first poses, tracking and absent objects on recordings of real sensors with references",
      AddBenchRealCommand);
  add("speed", "Measure how long decoding, tracking, first poses and the way through a server take",
      AddBenchSpeedCommand);
  add("synthetic",
      "Compare poses from labelled events, by the estimator of evpose and published ones, with the Cramer-Rao bound",
      AddBenchSyntheticCommand);
  add("tracking", "Compare trackers on simulated recordings with the truth", AddBenchTrackingCommand);
  app.footer(
      "Example:\n"
      "  evpose bench tracking --scenarios normal,half-out --seeds 1 --paths 1 --duration 0.2");
}

}  // namespace evpose::client
