// SPDX-License-Identifier: Apache-2.0
#include "client/cli/cli.h"

#include <algorithm>
#include <exception>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/bench/bench.h"
#include "client/cli/commands/commands.h"
#include "core/base/version.h"

namespace evpose::client {
namespace {

constexpr int kDone = 0;
constexpr int kFailed = 1;
constexpr int kWrongUsage = 2;

CommandRunners AddCommands(CLI::App& app, CliContext& context) {
  CommandRunners runners;
  const auto add = [&](const char* name, const char* description, auto add_command) {
    CLI::App* command = app.add_subcommand(name, description);
    runners.emplace_back(command, add_command(*command, context));
  };
  add("replay", "Send a recording to a server and write the poses that it returns", AddReplayCommand);
  add("stream", "Send the events of a live camera to a server", AddStreamCommand);
  add("info", "Print the contents of a recording", AddInfoCommand);
  add("doctor", "Check a recording or a live camera for what goes wrong most often", AddDoctorCommand);
  add("convert", "Write the events of a recording in another format", AddConvertCommand);
  add("simulate", "Simulate an event camera: write a recording and its true poses", AddSimulateCommand);
  add("evaluate", "Compare estimated trajectories with the truth", AddEvaluateCommand);
  add("target", "Make a printable target for evpose calibrate, and its model", AddTargetCommand);
  add("calibrate", "Estimate a camera from recordings of a moving target, and the profile of a sensor",
      AddCalibrateCommand);
  add("camera", "Print, check, convert and draw the calibration of a camera", AddCameraCommand);
  add("render", "Draw the events of a recording and the projected model", AddRenderCommand);
  add("watch", "Print the poses or the health of a session as they arrive", AddWatchCommand);
  AddBenchCommands(*app.add_subcommand("bench", "Compare evpose with published methods, and measure its speed"),
                   context, runners);
  AddSessionsCommands(*app.add_subcommand("sessions", "List, show, delete and drain the sessions of a server"), context,
                      runners);
  AddServerCommands(*app.add_subcommand("server", "Show the version and load of a server, or set the level of its log"),
                    context, runners);
  AddModelsCommands(*app.add_subcommand("models", "List, upload, show and delete the models of a server"), context,
                    runners);
  // After the commands, because their texts begin with that of their parent.
  app.footer(
      "The --help of each command has an example. Exit status: 0 success; 1 failure; 2 wrong usage.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --out cube/poses.tum");
  return runners;
}

std::string FullName(const CLI::App& command) {
  const CLI::App* parent = command.get_parent();
  return parent == nullptr ? command.get_name() : absl::StrCat(FullName(*parent), " ", command.get_name());
}

// One line with the name of the command, as the errors of the commands.
std::string UsageMessage(const CLI::App* app, const CLI::Error& error) {
  while (!app->get_subcommands().empty()) app = app->get_subcommands().back();
  const std::string name = FullName(*app);
  return absl::StrCat(name, ": ", error.what(), "; ", name, " --help lists the options\n");
}

// Reports an unknown command, which the parser would report as a missing one. Returns whether there was one.
bool ReportUnknownCommand(const CLI::App& app, const std::vector<std::string>& arguments, std::ostream& err) {
  const CLI::App* parent = &app;
  for (const std::string& word : arguments) {
    const std::vector<const CLI::App*> commands = parent->get_subcommands([](const CLI::App*) { return true; });
    if (commands.empty() || word.rfind('-', 0) == 0) return false;
    const auto command = std::find_if(commands.begin(), commands.end(),
                                      [&word](const CLI::App* each) { return each->check_name(word); });
    if (command == commands.end()) {
      const std::string name = FullName(*parent);
      err << name << ": there is no command \"" << word << "\"; " << name << " --help lists the commands" << std::endl;
      return true;
    }
    parent = *command;
  }
  return false;
}

// A result that could not be written is a failure.
int ExitStatus(int status, const std::string& name, CliContext& context) {
  context.out.flush();
  if (context.out || status != kDone) return status;
  context.err << name << ": the result could not be written completely to standard output: the disk is full, or its "
              << "reader has ended" << std::endl;
  return kFailed;
}

int RunParsed(const CommandRunners& runners, CliContext& context) {
  for (const auto& [command, run] : runners) {
    if (!command->parsed()) continue;
    const absl::Status status = run();
    if (status.ok()) return ExitStatus(kDone, FullName(*command), context);
    context.out.flush();
    context.err << FullName(*command) << ": " << status.message() << std::endl;
    return IsUsageError(status) ? kWrongUsage : kFailed;
  }
  return kWrongUsage;  // not reached: the parser requires a command
}

}  // namespace

int RunCli(const std::vector<std::string>& arguments, CliContext& context) {
  CLI::App app("6-DoF object poses from event cameras", "evpose");
  app.set_version_flag("--version", VersionLine("evpose"));
  app.require_subcommand(1);
  app.failure_message(UsageMessage);
  try {
    const CommandRunners runners = AddCommands(app, context);
    for (const auto& [command, run] : runners) command->get_parent()->require_subcommand(1);
    if (ReportUnknownCommand(app, arguments, context.err)) return kWrongUsage;
    std::vector<std::string> reversed(arguments.rbegin(), arguments.rend());
    try {
      app.parse(std::move(reversed));
    } catch (const CLI::ParseError& error) {
      const int status = app.exit(error, context.out, context.err) == 0 ? kDone : kWrongUsage;
      return ExitStatus(status, app.get_name(), context);
    }
    return RunParsed(runners, context);
  } catch (const std::exception& error) {
    context.err << "evpose: " << error.what() << std::endl;
    return kFailed;
  }
}

}  // namespace evpose::client
