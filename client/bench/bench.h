// SPDX-License-Identifier: Apache-2.0

// The commands below `evpose bench`. Each is one file with one function that adds it to the parser.
#pragma once

#include "client/cli/common/command.h"

namespace evpose::client {

// Group of --help with the options that say what is measured.
inline constexpr char kExperimentGroup[] = "Experiment";

void AddBenchCommands(CLI::App& app, CliContext& context, CommandRunners& runners);
CommandRunner AddBenchInitializationCommand(CLI::App& app, CliContext& context);
CommandRunner AddBenchLoadCommand(CLI::App& app, CliContext& context);
CommandRunner AddBenchModelsCommand(CLI::App& app, CliContext& context);
CommandRunner AddBenchRealCommand(CLI::App& app, CliContext& context);
CommandRunner AddBenchSpeedCommand(CLI::App& app, CliContext& context);
CommandRunner AddBenchSyntheticCommand(CLI::App& app, CliContext& context);
CommandRunner AddBenchTrackingCommand(CLI::App& app, CliContext& context);

}  // namespace evpose::client
