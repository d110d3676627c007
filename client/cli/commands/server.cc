// SPDX-License-Identifier: Apache-2.0

// evpose server: describes a server and sets its log level.
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/cli/commands/commands.h"
#include "client/cli/console/wait_message.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr std::pair<const char*, LogLevel> kLevels[] = {{"debug", LogLevel::kDebug},
                                                        {"info", LogLevel::kInfo},
                                                        {"warning", LogLevel::kWarning},
                                                        {"error", LogLevel::kError},
                                                        {"off", LogLevel::kOff}};

struct Arguments {
  ServerArguments server;
  std::string level;
  bool is_json = false;
};

std::string NameOf(LogLevel level) {
  for (const auto& [name, known] : kLevels) {
    if (known == level) return name;
  }
  return "";
}

absl::Status RunInfo(const Arguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  EVPOSE_ASSIGN_OR_RETURN(const ServerInfo info, WaitFor(context, "the answer of " + arguments.server.address,
                                                         [&] { return client->GetServerInfo(); }));
  const Json json = {{"version", info.version},
                     {"commit", info.commit},
                     {"store", info.store},
                     {"active_sessions", info.active_sessions},
                     {"max_sessions", info.max_sessions},
                     {"max_chunk_bytes", info.max_chunk_bytes},
                     {"max_model_bytes", info.max_model_bytes},
                     {"pose_log_capacity", info.pose_log_capacity},
                     {"session_expiry_s", absl::ToDoubleSeconds(info.session_expiry)},
                     {"skipped_events", info.skipped_events},
                     {"draining", info.is_draining}};
  return PrintResult(context, arguments.is_json, json, [&info](std::ostream& out) {
    out << "evpose-server " << info.version << " (" << info.commit << "), store: " << info.store << ", "
        << info.active_sessions << " of " << info.max_sessions << " sessions"
        << (info.is_draining ? ", shutting down" : "") << "\n";
  });
}

absl::Status RunLogLevel(const Arguments& arguments, CliContext& context) {
  LogLevel level = LogLevel::kInfo;
  for (const auto& [name, known] : kLevels) {
    if (arguments.level == name) level = known;
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  EVPOSE_ASSIGN_OR_RETURN(const LogLevel before, WaitFor(context, "the answer of " + arguments.server.address,
                                                         [&] { return client->SetLogLevel(level); }));
  const std::string previous = NameOf(before);
  const auto print = [&](std::ostream& out) {
    out << "log level: " << arguments.level << ", was " << previous << "\n";
  };
  return PrintResult(context, arguments.is_json, {{"level", arguments.level}, {"previous_level", previous}}, print, -1);
}

}  // namespace

void AddServerCommands(CLI::App& app, CliContext& context, CommandRunners& runners) {
  const auto add = [&](const char* name, const char* description, auto run) {
    CLI::App* command = app.add_subcommand(name, description);
    auto arguments = std::make_shared<Arguments>();
    arguments->server.AddTo(*command, true);
    AddJson(*command, arguments->is_json);
    runners.emplace_back(command, [arguments, run, &context] { return run(*arguments, context); });
    return std::pair(command, arguments);
  };
  add("info", "Print version, store and number of sessions of a server", RunInfo)
      .first->footer("Example:\n  evpose server info --server 127.0.0.1:50051");
  const auto [command, arguments] =
      add("log-level",
          "Set the level of a server's log until its process ends; a server with tokens requires the token of an "
          "operator",
          RunLogLevel);
  command->add_option("level", arguments->level, "Lowest level that is written")
      ->required()
      ->group(kInputGroup)
      ->check(CLI::IsMember({"debug", "info", "warning", "error", "off"}));
  command->footer("Example:\n  evpose server log-level debug --server 127.0.0.1:50051");
  app.footer("Example:\n  evpose server info --server 127.0.0.1:50051");
}

}  // namespace evpose::client
