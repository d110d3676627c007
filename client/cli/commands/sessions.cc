// SPDX-License-Identifier: Apache-2.0

// evpose sessions: lists, describes and deletes the sessions of a server, and drains it.
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/time/time.h"
#include "client/cli/commands/commands.h"
#include "client/cli/console/wait_message.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

struct SessionArguments {
  ServerArguments server;
  std::string name;
  bool is_json = false;
  std::optional<double> timeout_s;
};

Json SessionJson(const Session& session) {
  Json json = {{"name", session.name},
               {"trace_id", TraceId(session.name)},
               {"state", std::string(SessionStateName(session.state))},
               {"create_time", absl::FormatTime(session.create_time, absl::UTCTimeZone())},
               {"expire_time", session.expire_time ? Json(absl::FormatTime(*session.expire_time, absl::UTCTimeZone()))
                                                   : Json(nullptr)},
               {"encoding", std::string(EventEncodingName(session.config.encoding))},
               {"width", session.config.camera.width_px},
               {"height", session.config.camera.height_px},
               {"events", session.health.decoded_events},
               {"poses", session.health.poses},
               {"real_time_ratio", session.health.real_time_ratio},
               {"processing", ProcessingJson(session.health.processing)},
               {"objects", Json::array()}};
  for (const ObjectHealth& object : session.health.objects) json["objects"].push_back(ObjectJson(object));
  return json;
}

void PrintSession(const Session& session, std::ostream& out) {
  out << session.name << "  " << SessionStateName(session.state)
      << absl::StrFormat("  %s  %s", Counted(session.health.decoded_events, "event"),
                         Counted(session.health.poses, "pose"));
  for (const ObjectHealth& object : session.health.objects) {
    out << "  " << object.object_id << " " << DescribeState(object) << ", " << Counted(object.losses, "loss", "losses");
  }
  out << "\n";
}

absl::Status RunListSessions(const SessionArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  EVPOSE_ASSIGN_OR_RETURN(
      const std::vector<Session> sessions,
      WaitFor(context, "the sessions of " + arguments.server.address, [&] { return client->ListSessions(); }));
  if (sessions.empty() && context.is_err_terminal) context.err << "no sessions" << std::endl;
  return PrintList(context, arguments.is_json, sessions, SessionJson, PrintSession);
}

absl::Status RunGetSession(const SessionArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  const absl::StatusOr<Session> session =
      WaitFor(context, "the state of " + arguments.name, [&] { return client->GetSession(arguments.name); });
  if (!session.ok()) return SessionError(arguments.name, session.status());
  return PrintResult(context, arguments.is_json, SessionJson(*session), [&session](std::ostream& out) {
    PrintSession(*session, out);
    out << "processor time: " << DescribeProcessing(session->health.processing) << "\n";
    for (const ObjectHealth& object : session->health.objects) {
      if (!object.detail.empty()) out << object.object_id << ": " << object.detail << "\n";
    }
  });
}

absl::Status RunDeleteSession(const SessionArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  const absl::Status status =
      WaitFor(context, "the state of " + arguments.name, [&] { return client->GetSession(arguments.name).status(); });
  if (absl::IsNotFound(status)) {
    context.err << "evpose sessions delete: " << SessionError(arguments.name, status).message() << std::endl;
  }
  return WaitFor(context, "the server to delete " + arguments.name,
                 [&] { return client->DeleteSession(arguments.name); });
}

absl::Status RunDrain(const SessionArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  std::optional<absl::Duration> timeout;
  if (arguments.timeout_s) timeout = absl::Seconds(*arguments.timeout_s);
  EVPOSE_ASSIGN_OR_RETURN(const uint32_t remaining, WaitFor(context, "the answer of " + arguments.server.address,
                                                            [&] { return client->Drain(timeout); }));
  const auto print = [remaining](std::ostream& out) {
    out << "the server is shutting down; sessions with an attached stream: " << remaining << "\n";
  };
  return PrintResult(context, arguments.is_json, {{"remaining_sessions", remaining}}, print, -1);
}

// Returns an example with the session that a replay has kept.
std::string Example(const std::string& command, bool has_name) {
  return absl::StrCat(
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose replay cube/recording.raw --model cube/model.obj --camera cube/camera.yaml --server 127.0.0.1:50051 "
      "--keep-session\n",
      has_name ? "  session=$(evpose sessions list --server 127.0.0.1:50051 | sed 's/ .*//;q')\n" : "",
      "  evpose sessions ", command, has_name ? " \"$session\"" : "", " --server 127.0.0.1:50051");
}

}  // namespace

void AddSessionsCommands(CLI::App& app, CliContext& context, CommandRunners& runners) {
  const auto add = [&](const char* name, const char* description, auto run, bool has_name) {
    CLI::App* command = app.add_subcommand(name, description);
    command->footer(Example(name, has_name));
    auto arguments = std::make_shared<SessionArguments>();
    if (has_name) AddSessionName(*command, arguments->name);
    arguments->server.AddTo(*command, true);
    AddJson(*command, arguments->is_json, "Print JSON with all fields instead of text");
    runners.emplace_back(command, [arguments, run, &context] { return run(*arguments, context); });
    return std::pair(command, arguments);
  };
  add("list", "List the sessions of a server, one on each line", RunListSessions, false);
  add("get", "Print the state of one session", RunGetSession, true);
  add("delete", "Delete a session; its streams end. A session that does not exist is no error", RunDeleteSession, true);
  const auto [drain, drain_arguments] = add("drain",
                                            "Shut the server down after its streams have had time to finish; a server "
                                            "with tokens requires the token of an operator",
                                            RunDrain, false);
  drain
      ->add_option("--timeout", drain_arguments->timeout_s,
                   "Time that streams have to finish. Default: the server's --shutdown-timeout")
      ->type_name("SECONDS")
      ->check(NotNegative())
      ->group("Shutdown");
  app.footer(
      "Example:\n"
      "  evpose sessions list --server 127.0.0.1:50051");
}

}  // namespace evpose::client
