// SPDX-License-Identifier: Apache-2.0
#include "client/cli/cli.h"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <exception>
#include <iostream>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/bench/bench.h"
#include "client/cli/commands/commands.h"
#include "client/cli/console/standard_streams.h"
#include "client/cli/file_arguments.h"
#include "client/cli/first_steps.h"
#include "core/base/version.h"
#include "core/command_line/help.h"
#include "core/command_line/suggestion.h"
#include "core/command_line/usage_message.h"

namespace evpose::client {
namespace {

constexpr int kDone = 0;
constexpr int kFailed = 1;
constexpr int kWrongUsage = 2;

// The purposes by which `evpose --help` lists the commands, in this order.
constexpr char kTracking[] = "Track objects";
constexpr char kRecordings[] = "Recordings and poses";
constexpr char kPreparation[] = "Cameras and models";
constexpr char kServers[] = "Servers";
constexpr char kResearch[] = "Research";

CommandRunners AddCommands(CLI::App& app, CliContext& context) {
  CommandRunners runners;
  const auto add = [&](const char* purpose, const char* name, const char* description, auto add_command) {
    CLI::App* const command = app.add_subcommand(name, description);
    runners.emplace_back(command, add_command(*command, context));
    command->group(purpose);
  };
  const auto add_several = [&](const char* purpose, const char* name, const char* description, auto add_commands) {
    CLI::App* const parent = app.add_subcommand(name, description);
    add_commands(*parent, context, runners);
    parent->group(purpose);  // at the end, because the commands below inherit it
  };
  add(kTracking, "replay", "Track the objects in a recording and write their poses", AddReplayCommand);
  add(kTracking, "stream", "Track objects with a live camera and write their poses", AddStreamCommand);
  add(kTracking, "watch", "Print the poses or the health of a session as they arrive", AddWatchCommand);
  add(kTracking, "view", "Show a session, or a recording with its poses, on a page in the browser", AddViewCommand);
  add(kRecordings, "simulate", "Simulate an event camera: write a recording and its true poses", AddSimulateCommand);
  add(kRecordings, "info", "Print the contents of a recording", AddInfoCommand);
  add(kRecordings, "doctor", "Check a recording, a live camera or a server for what goes wrong most often",
      AddDoctorCommand);
  add(kRecordings, "convert", "Write the events of a recording in another format", AddConvertCommand);
  add(kRecordings, "render", "Draw the events of a recording and the model at its poses", AddRenderCommand);
  add(kRecordings, "evaluate", "Compare estimated poses with the truth", AddEvaluateCommand);
  add(kPreparation, "camera", "Print, check, convert and draw the calibration of a camera", AddCameraCommand);
  add(kPreparation, "target", "Make a printable target for evpose calibrate, and its model", AddTargetCommand);
  add(kPreparation, "calibrate", "Estimate a camera, the profile of a sensor, or where a robot carries the camera",
      AddCalibrateCommand);
  add_several(kPreparation, "models", "Inspect model files, and manage the models of a server", AddModelsCommands);
  add_several(kServers, "server", "Describe a server, or set the level of its log", AddServerCommands);
  add_several(kServers, "sessions", "List, show and delete the sessions of a server, or drain it", AddSessionsCommands);
  add_several(kResearch, "bench", "Compare evpose with published methods, and measure its speed", AddBenchCommands);
  app.footer(
      "evpose COMMAND --help describes a command, with an example.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --out cube/poses.tum");
  return runners;
}

// One line with the name of the command, as the errors of the commands.
std::string ParserMessage(const CLI::App* app, const CLI::Error& error) {
  while (!app->get_subcommands().empty()) app = app->get_subcommands().back();
  return UsageMessage(*app, error) + "\n";
}

// Reports an unknown command, or a missing one, which the parser would report less clearly. Returns whether there was
// such an error.
bool ReportWrongCommand(const CLI::App& app, const std::vector<std::string>& arguments, std::ostream& err) {
  const CLI::App* parent = &app;
  std::vector<std::string> names;
  const auto look = [&] {
    names.clear();
    for (const CLI::App* each : parent->get_subcommands([](const CLI::App*) { return true; })) {
      names.push_back(each->get_name());
    }
  };
  look();
  for (const std::string& word : arguments) {
    if (names.empty() || absl::StartsWith(word, "-")) return false;
    if (std::find(names.begin(), names.end(), word) == names.end()) {
      const std::string nearest = NearestName(word, names);
      err << FullCommandName(*parent) << ": there is no command \"" << word << "\"; "
          << (nearest.empty() ? "" : absl::StrCat("did you mean ", nearest, "? ")) << HelpHint(*parent) << std::endl;
      return true;
    }
    parent = parent->get_subcommand(word);
    look();
  }
  if (names.empty()) return false;
  err << FullCommandName(*parent) << ": give a command: " << absl::StrJoin(names, ", ") << "; " << HelpHint(*parent)
      << std::endl;
  return true;
}

// A result that could not be written is a failure.
int ExitStatus(int status, const std::string& name, CliContext& context) {
  context.out.flush();
  if (context.out || status != kDone) return status;
  pollfd output = {STDOUT_FILENO, POLLOUT, 0};
  if (&context.out == &std::cout && poll(&output, 1, 0) == 1 && (output.revents & POLLERR) != 0) {
    return kFailed;  // the reader of a pipe, such as head, has ended: it has read what it wanted
  }
  const bool is_closed = &context.out == &std::cout && IsStandardOutputClosed();
  context.err << name << ": the result could not be written completely to standard output: "
              << (is_closed ? "it is closed" : "the disk is full") << std::endl;
  return kFailed;
}

int RunParsed(const CommandRunners& runners, CliContext& context) {
  for (const auto& [command, run] : runners) {
    if (!command->parsed()) continue;
    absl::Status status = CheckFileArguments(*command);
    if (status.ok()) status = run();
    if (status.ok()) return ExitStatus(kDone, FullCommandName(*command), context);
    context.out.flush();
    const bool is_usage = IsUsageError(status);
    context.err << FullCommandName(*command) << ": " << status.message()
                << (is_usage ? absl::StrCat("; ", HelpHint(*command)) : "") << std::endl;
    return is_usage ? kWrongUsage : kFailed;
  }
  return kWrongUsage;  // not reached: the parser requires a command
}

}  // namespace

std::unique_ptr<CLI::App> MakeParser(CliContext& context, CommandRunners& runners) {
  auto app = std::make_unique<CLI::App>("6-DoF object poses from event cameras", "evpose");
  app->set_version_flag("--version", VersionLine("evpose"));
  app->require_subcommand(1);
  app->failure_message(ParserMessage);
  runners = AddCommands(*app, context);
  for (const auto& [command, run] : runners) command->get_parent()->require_subcommand(1);
  UseHelp(*app);
  return app;
}

int RunCli(const std::vector<std::string>& arguments, CliContext& context) {
  if (arguments.empty()) {
    context.err << FirstSteps(TextWidth(STDERR_FILENO)) << std::flush;
    return kWrongUsage;
  }
  if (arguments.front() == "help") {  // "help replay" is "replay --help"
    std::vector<std::string> words(arguments.begin() + 1, arguments.end());
    words.emplace_back("--help");
    return RunCli(words, context);
  }
  try {
    CommandRunners runners;
    const std::unique_ptr<CLI::App> app = MakeParser(context, runners);
    if (ReportWrongCommand(*app, arguments, context.err)) return kWrongUsage;
    std::vector<std::string> reversed(arguments.rbegin(), arguments.rend());
    try {
      app->parse(std::move(reversed));
    } catch (const CLI::ParseError& error) {
      const int status = app->exit(error, context.out, context.err) == 0 ? kDone : kWrongUsage;
      return ExitStatus(status, app->get_name(), context);
    }
    return RunParsed(runners, context);
  } catch (const std::exception& error) {
    context.err << "evpose: " << error.what() << std::endl;
    return kFailed;
  }
}

}  // namespace evpose::client
