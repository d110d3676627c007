// SPDX-License-Identifier: Apache-2.0

// The commands of `evpose`. Each file has one function that adds its command to the parser; `evpose bench` is in
// client/bench.
#pragma once

#include "client/cli/common/command.h"

namespace evpose::client {

CommandRunner AddCalibrateCommand(CLI::App& app, CliContext& context);
CommandRunner AddCameraCommand(CLI::App& app, CliContext& context);
CommandRunner AddConvertCommand(CLI::App& app, CliContext& context);
CommandRunner AddDoctorCommand(CLI::App& app, CliContext& context);
CommandRunner AddEvaluateCommand(CLI::App& app, CliContext& context);
CommandRunner AddInfoCommand(CLI::App& app, CliContext& context);
CommandRunner AddRenderCommand(CLI::App& app, CliContext& context);
CommandRunner AddInspectCommand(CLI::App& models, CliContext& context);  // a part of evpose models
CommandRunner AddReplayCommand(CLI::App& app, CliContext& context);
CommandRunner AddSimulateCommand(CLI::App& app, CliContext& context);
CommandRunner AddStreamCommand(CLI::App& app, CliContext& context);
CommandRunner AddTargetCommand(CLI::App& app, CliContext& context);
CommandRunner AddViewCommand(CLI::App& app, CliContext& context);
CommandRunner AddWatchCommand(CLI::App& app, CliContext& context);
// Each of these adds several commands.
void AddModelsCommands(CLI::App& app, CliContext& context, CommandRunners& runners);
void AddServerCommands(CLI::App& app, CliContext& context, CommandRunners& runners);
void AddSessionsCommands(CLI::App& app, CliContext& context, CommandRunners& runners);

}  // namespace evpose::client
