// SPDX-License-Identifier: Apache-2.0

// evpose bench: the methods against others, on trials and recordings that it makes itself.
#include "client/bench/bench.h"

namespace evpose::client {

void AddBenchCommands(CLI::App& app, CliContext& context, CommandRunners& runners) {
  const auto add = [&](const char* name, const char* description, auto add_command) {
    CLI::App* command = app.add_subcommand(name, description);
    runners.emplace_back(command, add_command(*command, context));
  };
  add("initialization", "First poses from lines, by evpose and by published methods", AddBenchInitializationCommand);
  add("models", "Model files: preparation, and tracking from the true pose on simulated recordings",
      AddBenchModelsCommand);
  add("real", "Recordings of real sensors with references: first poses, tracking, and absent objects",
      AddBenchRealCommand);
  add("speed", "Decoding, tracking, first poses and the way through a server: how long they take",
      AddBenchSpeedCommand);
  add("synthetic",
      "Poses from labelled events, by the estimator of evpose and published ones, and the Cramer-Rao bound",
      AddBenchSyntheticCommand);
  add("tracking", "Trackers on simulated recordings, against the truth", AddBenchTrackingCommand);
  app.footer(
      "Each of them has an example in its --help.\n\n"
      "Example:\n"
      "  evpose bench tracking --scenarios normal,half-out --seeds 1 --paths 1 --duration 0.2");
}

}  // namespace evpose::client
