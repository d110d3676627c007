// SPDX-License-Identifier: Apache-2.0
#include "server/program/options.h"

#include <CLI/CLI.hpp>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <optional>
#include <system_error>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"
#include "absl/time/time.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/base/version.h"
#include "core/command_line/help.h"
#include "core/command_line/usage_message.h"
#include "server/connections/listen_address.h"
#include "server/program/session_memory.h"
#include "server/program/store_options.h"
#include "server/runtime/errors.h"
#include "server/sessions/memory/available_memory.h"

namespace evpose::server {
namespace {

constexpr char kProgram[] = "evpose-server";
constexpr char kDescription[] = "Track objects in streams of events: receive events and send poses over gRPC";

constexpr char kNotes[] =
    "The files of Access are read again when they change. A limit of a tenant that is 0 means that only the limits of "
    "the server apply. With tokens or client certificates its default is half of the server's limit, except those of "
    "processor time, bytes and health messages per second; without them it is 0.\n\n"
    "With port 0 a free port is chosen. When the server is ready it prints \"listening on HOST:PORT\" on standard "
    "output and, with --metrics-listen, a second line, \"metrics on HOST:PORT\", and with "
    "--load-listen another one, \"load on HOST:PORT\"; its log goes to standard error. "
    "After SIGTERM or SIGINT the server waits for --shutdown-notice, lets clients finish for up to "
    "--shutdown-timeout, and ends; a second signal ends it at once.\n\n"
    "Exit status:\n"
    "  0  The server was asked to end, and has ended\n"
    "  1  Failure; its cause and remedy are on standard error\n"
    "  2  Wrong usage\n\n";

constexpr char kExample[] = R"(Example:
  evpose-server --listen 127.0.0.1:50051
then, in another shell of the same machine:
  evpose replay recording.raw --model model.obj --camera camera.yaml --server 127.0.0.1:50051
For other machines, with a certificate and a token:
  (umask 077; evpose-server --new-token lab --token-file tokens > lab.token)
  evpose-server --listen 0.0.0.0:50051 --tls-cert server.crt --tls-key server.key --token-file tokens
  evpose sessions list --server localhost:50051 --tls-ca ca.crt --token-file lab.token
For several servers that take over each other's sessions, each with
  evpose-server --listen 127.0.0.1:50051 --store redis://127.0.0.1:6379 --store-password-file redis.password
or, if no acknowledged commit may be lost, on PostgreSQL with a synchronous standby:
  evpose-server --store 'postgresql://evpose@db1,db2/evpose?sslmode=verify-full' --store-password-file pg.password
or with the whole address, including the password, in the environment variable EVPOSE_STORE. Every user of the machine
can read a password on the command line.
)";

// The options, and the values for which CLI11 has no type: durations in seconds.
struct Arguments {
  ProgramOptions& program;
  std::optional<uint64_t> max_session_memory;  // not given: the default depends on other options
  double session_expiry_s = absl::ToDoubleSeconds(ServerOptions().session_expiry);
  double listener_timeout_s = absl::ToDoubleSeconds(ServerOptions().listener_timeout);
  double stream_idle_timeout_s = absl::ToDoubleSeconds(ServerOptions().stream_idle_timeout);
  double attach_timeout_s = absl::ToDoubleSeconds(ServerOptions().attach_timeout);
  double response_timeout_s = absl::ToDoubleSeconds(ServerOptions().response_timeout);
  double upload_timeout_s = absl::ToDoubleSeconds(ServerOptions().upload_timeout);
  double shutdown_timeout_s = absl::ToDoubleSeconds(ServerOptions().drain_timeout);
  double shutdown_notice_s = 0.0;
};

// An empty value, as of a variable of the shell that is not set, would have the effect of an absent option.
CLI::Validator NotEmpty(const std::string& error) {
  return CLI::Validator([error](const std::string& text) { return text.empty() ? error : std::string(); }, "");
}

void DefineAccess(CLI::App& app, Arguments& arguments) {
  ServerOptions& options = arguments.program.server;
  app.option_defaults()->group("Access");
  app.add_option("--tls-cert", options.tls.certificate, "Certificate of the server with its chain, PEM")
      ->type_name("FILE");
  app.add_option("--tls-key", options.tls.key, "Private key of that certificate, PEM")->type_name("FILE");
  app.add_option("--tls-client-ca", options.tls.client_ca,
                 "Clients must present a certificate signed by one of these authorities, PEM; without --token-file its "
                 "CN is the client's tenant")
      ->type_name("FILE");
  app.add_option("--tls-client-crl", options.tls.client_crl,
                 "Revocation lists of these authorities, PEM: clients with a revoked certificate are rejected")
      ->type_name("FILE");
  app.add_option("--token-file", options.token_file, "Clients must send one of these tokens; --new-token adds a line")
      ->type_name("FILE");
  app.add_option("--new-token", arguments.program.new_token,
                 "Make a token for this tenant, print it, and exit; its line is added to --token-file or, without one, "
                 "printed on standard error")
      ->type_name("TENANT")
      ->check(NotEmpty("the tenant's name is empty"));
  app.add_flag("--operator", arguments.program.is_operator,
               "With --new-token: the token allows its holder to drain the server and to set its log level")
      ->needs("--new-token");
  app.add_flag("--insecure", arguments.program.permits_insecure,
               "Permit --listen on an address that other machines can reach, without encryption or without "
               "authentication");
}

void DefineStorage(CLI::App& app, Arguments& arguments) {
  ServerOptions& options = arguments.program.server;
  app.option_defaults()->group("Storage");
  app.add_option(
         "--store", options.store.store,
         "Store of sessions, poses and models: sqlite, one file in --data-dir; memory, lost when the server ends; "
         "redis://[USER:PASSWORD@]HOST:PORT[/DB], for several servers that take over each other's sessions; "
         "redis+sentinel://HOST:PORT,.../NAME, the same, with the same optional parts, at the addresses of "
         "Sentinels, which replace a failed master of this name; "
         "redis-groups:FILE, several of these, among which the sessions are divided, each as a line NAME ADDRESS; "
         "postgresql://[USER:PASSWORD@]HOST[:PORT],.../DATABASE, "
         "for several servers, without the loss of an acknowledged commit if PostgreSQL has a synchronous standby")
      ->envname("EVPOSE_STORE")
      ->type_name("NAME|ADDRESS");
  app.add_option("--store-password-file", arguments.program.store_password_file,
                 "File with the password of a redis://, redis+sentinel:// or postgresql:// store if its address has "
                 "none, and of "
                 "the addresses of redis-groups:FILE that have none")
      ->type_name("FILE");
  app.add_flag(
      "--divide-store", arguments.program.divides_store,
      "Move sessions until all Redis groups of --store redis-groups:FILE have equal parts of the store, and "
      "exit. Before it, add the new group to the files of all servers and restart them. Servers may run meanwhile");
  app.add_option(
         "--data-dir", options.store.data_dir,
         "Directory of --store sqlite, used by one server only; by default $STATE_DIRECTORY, which systemd sets, "
         "else $XDG_STATE_HOME/evpose, else ~/.local/state/evpose")
      ->type_name("DIR");
  app.add_option(
         "--store-max-bytes", options.store.max_bytes,
         "Maximum bytes of --store sqlite, memory and postgresql:// (sessions and models); when it is reached, ended "
         "sessions are deleted, the oldest first, and then streams end with an error; Redis has its own limit, "
         "maxmemory")
      ->type_name("BYTES");
  app.add_option(
         "--session-expiry", arguments.session_expiry_s,
         "Time after which a session without a stream is deleted; must be equal at all servers that share a store")
      ->type_name("SECONDS");
  app.add_option("--pose-log-capacity", options.pose_log_capacity,
                 "Poses kept per session for readers and reconnecting streams; older ones are deleted");
  app.add_option(
         "--pose-log-bytes", options.pose_log_bytes,
         "Bytes of these poses per session in the store; the oldest ones beyond it are deleted, but not the last "
         "4096 poses")
      ->type_name("BYTES");
}

void DefineLimits(CLI::App& app, Arguments& arguments) {
  ServerOptions& options = arguments.program.server;
  app.option_defaults()->group("Limits");
  app.add_option("--max-sessions", options.max_sessions,
                 "Sessions at a time, including ended ones until they are deleted or expire");
  app.add_option(
         "--max-session-memory", arguments.max_session_memory,
         "Bytes of memory for all sessions together; each counts with the most that it may take. Default: 75 % "
         "of the memory of the machine or the control group, or what --slow-threads preparations with "
         "--model-memory each, --max-model-store-bytes, 1.25 times --max-transport-bytes and 0.2 GB leave of it, "
         "whichever is less, but at least 25 %")
      ->type_name("BYTES");
  app.add_option("--max-connections", options.max_connections,
                 "Connections at a time; 0: half of the descriptors that the process may have, at most 4096");
  app.add_option("--max-connections-per-peer", options.max_connections_per_peer,
                 "Connections at a time from one address (64 bits of IPv6), which behind a proxy is that of the proxy; "
                 "0: half of all");
  app.add_option("--max-transport-bytes", options.max_transport_bytes,
                 "Bytes of memory of gRPC for connections and calls; beyond it, connections are read later or closed")
      ->type_name("BYTES");
  app.add_option("--max-streams", options.max_streams, "Streams of events, poses, health and images at a time");
  app.add_option("--max-calls-per-connection", options.max_calls_per_connection,
                 "Calls at a time on one connection; further calls wait at the client");
  app.add_option("--max-model-bytes", options.max_model_bytes, "Bytes of one model file")->type_name("BYTES");
  app.add_option("--max-model-store-bytes", options.max_model_store_bytes,
                 "Bytes of all model files and of what was derived from them")
      ->type_name("BYTES");
  app.add_option("--max-uploads", options.max_uploads, "Uploads of models at a time");
  app.add_option("--upload-timeout", arguments.upload_timeout_s, "Time within which the file of an upload must arrive")
      ->type_name("SECONDS");
  app.add_option("--model-cpu-seconds", options.model_budget.cpu_seconds,
                 "Processor time for the preparation of one model, and once more for its views")
      ->type_name("SECONDS");
  app.add_option("--model-memory", options.model_budget.memory_bytes,
                 "Bytes of memory for the preparation of one model")
      ->type_name("BYTES");
  app.add_option("--max-chunk-bytes", options.max_chunk_bytes, "Bytes of one chunk of events")->type_name("BYTES");
  app.add_option("--credit-bytes", options.credit_bytes, "Bytes of events that may wait per session")
      ->type_name("BYTES");
  app.add_option("--max-session-cpu", options.max_session_cpu,
                 "Processor seconds per second of one session; 0: no limit; a session at the limit waits")
      ->type_name("CORES");
  app.add_option("--max-load", options.max_load,
                 "Load of the workers (0 to 1, mean over 5 s): after 5 s above this bound, a tenant with a session on "
                 "this server cannot create another one; 0: no bound, because replays use all time that cameras leave")
      ->envname("EVPOSE_MAX_LOAD")
      ->type_name("RATIO");
}

void DefineTimeouts(CLI::App& app, Arguments& arguments) {
  app.option_defaults()->group("Limits");
  app.add_option("--attach-timeout", arguments.attach_timeout_s,
                 "Time within which a new stream must attach, and an upload must send its next message")
      ->type_name("SECONDS");
  app.add_option("--response-timeout", arguments.response_timeout_s,
                 "Time within which a client must have taken the response of a call, except on streams")
      ->type_name("SECONDS");
  app.add_option("--stream-idle-timeout", arguments.stream_idle_timeout_s,
                 "Time without a message after which a stream of events ends, so that its session can expire; 0: no "
                 "limit")
      ->type_name("SECONDS");
  app.add_option("--listener-timeout", arguments.listener_timeout_s,
                 "Time after which a server that does not accept its own connections ends with status 1")
      ->type_name("SECONDS");
}

void DefineTenantLimits(CLI::App& app, ServerOptions& options) {
  app.option_defaults()->group("Limits of each tenant");
  app.add_option("--tenant-max-sessions", options.tenant.max_sessions, "Sessions at a time");
  app.add_option("--tenant-max-session-memory", options.tenant.max_session_memory,
                 "Bytes of memory for all sessions of the tenant together")
      ->type_name("BYTES");
  app.add_option("--tenant-max-model-bytes", options.tenant.max_model_bytes,
                 "Bytes of all model files of the tenant and of what was derived from them")
      ->type_name("BYTES");
  app.add_option("--tenant-max-streams", options.tenant.max_streams,
                 "Streams of events, poses, health and images at a time, of all sessions of the tenant");
  app.add_option("--tenant-max-watchers", options.tenant.max_watchers, "Readers of poses, health and images at a time");
  app.add_option("--tenant-max-uploads", options.tenant.max_uploads, "Uploads of models at a time");
  app.add_option("--tenant-max-bytes-per-s", options.tenant.max_bytes_per_s,
                 "Bytes of events per second; the server reads faster streams more slowly; 0: no limit")
      ->type_name("BYTES")
      ->default_str("0");
  app.add_option("--tenant-max-health-per-s", options.tenant.max_health_per_s,
                 "Messages per second to readers of health; the server sends more of them less often; 0: no limit")
      ->type_name("HZ");
  app.add_option(
         "--tenant-max-cpu", options.tenant.max_cpu,
         "Processor seconds per second of all sessions of the tenant; without it tenants share the workers equally")
      ->type_name("CORES");
}

void DefineArguments(CLI::App& app, Arguments& arguments) {
  ServerOptions& options = arguments.program.server;
  options.listen_address = "127.0.0.1:50051";
  options.store.store = "sqlite";
  app.footer(absl::StrCat(kNotes, kExample));
  app.set_version_flag("--version", VersionLine("evpose-server"));
  app.option_defaults()->always_capture_default();
  app.option_defaults()->group("Server");
  app.add_option("--listen", options.listen_address, "HOST:PORT to listen on; port 0 chooses a free port")
      ->type_name("HOST:PORT");
  app.add_option("--port-file", arguments.program.port_file, "Write the port to this file when ready")
      ->type_name("FILE");
  app.add_option("--metrics-listen", arguments.program.metrics_listen,
                 "HOST:PORT of the HTTP pages /metrics (Prometheus), /healthz and /readyz, which need no "
                 "authentication; "
                 "port 0 chooses a free port; without this option there are no pages")
      ->type_name("HOST:PORT");
  app.add_option("--load-listen", arguments.program.load_listen,
                 "HOST:PORT at which HAProxy's agent-check reads the weight of this server, 100 % minus its load; no "
                 "authentication; port 0 chooses a free port; without this option the load is in /metrics only")
      ->type_name("HOST:PORT");
  app.add_option("--workers", options.worker_threads, "Threads that decode and track; 0: one per core");
  app.add_option("--slow-threads", options.slow_threads,
                 "Threads for slow work, such as creating sessions, and models that are prepared at a time");
  app.add_option("--event-images", options.serves_event_images,
                 "Whether clients may watch images of the events of their sessions: true or false")
      ->type_name("BOOLEAN")
      ->default_str("true");
  app.add_option("--shutdown-timeout", arguments.shutdown_timeout_s,
                 "Time within which streams must finish when the server shuts down")
      ->type_name("SECONDS");
  app.add_option("--shutdown-notice", arguments.shutdown_notice_s,
                 "Time from SIGTERM or SIGINT until streams are asked to finish; meanwhile only readiness and health "
                 "change, so that a load balancer stops sending new clients")
      ->type_name("SECONDS");
  app.add_option("--log-level", arguments.program.log_level,
                 "Minimum level of the log; evpose server log-level changes it while the server runs")
      ->envname("EVPOSE_LOG_LEVEL")
      ->check(CLI::IsMember({"debug", "info", "warning", "error", "off"}));
  app.add_option("--log-format", arguments.program.log_format,
                 "Format of the log, which has one line for each event: text, or a JSON object")
      ->envname("EVPOSE_LOG_FORMAT")
      ->check(CLI::IsMember({"text", "json"}));
  DefineAccess(app, arguments);
  DefineStorage(app, arguments);
  DefineLimits(app, arguments);
  DefineTimeouts(app, arguments);
  DefineTenantLimits(app, options);
  for (CLI::Option* const option : app.get_options()) {
    if (option->get_type_name() == "FILE") option->check(NotEmpty("the name is empty"));
  }
}

// Describes an error of ServerOptions::Validate() with the command-line option that sets the invalid field. An error of
// the TLS files names its options itself.
std::string InOptions(const absl::Status& status) {
  constexpr std::pair<absl::string_view, absl::string_view> kOtherNames[] = {
      {"listen_address", "listen"},
      {"worker_threads", "workers"},
      {"drain_timeout", "shutdown-timeout"},
      {"model_budget.cpu_seconds", "model-cpu-seconds"},
      {"model_budget.memory_bytes", "model-memory"}};
  const std::string field = GetErrorDetails(status).field;
  absl::string_view description = status.message();
  if (field.empty() || !absl::ConsumePrefix(&description, absl::StrCat(field, ": "))) return std::string(description);
  if (field == "tls") return std::string(description);
  std::string name = absl::StrReplaceAll(field, {{"_", "-"}, {".", "-"}});
  for (const auto& [member, option] : kOtherNames) {
    if (field == member) name = std::string(option);
  }
  return absl::StrCat("--", name, ": ", description);
}

// Returns the reason for which the server must not listen on this address, or an empty string.
std::string Exposure(const ProgramOptions& program, const ListenAddress& address) {
  const ServerOptions& options = program.server;
  if (address.IsLoopback() || program.permits_insecure) return "";
  const std::string reached = absl::StrCat("other machines can reach ", options.listen_address);
  if (!options.tls.has_tls()) {
    return absl::StrCat(reached,
                        ", and nothing is encrypted: give --tls-cert and --tls-key, listen on 127.0.0.1, or give "
                        "--insecure");
  }
  if (options.token_file.empty() && options.tls.client_ca.empty()) {
    return absl::StrCat(reached,
                        ", and anybody may use the server: give --token-file or --tls-client-ca, listen on "
                        "127.0.0.1, or give --insecure");
  }
  return "";
}

absl::Status CheckMetricsAddress(const ProgramOptions& options) {
  if (options.metrics_listen.empty()) return absl::OkStatus();
  EVPOSE_ASSIGN_OR_RETURN(const ListenAddress address, ParseListenAddress(options.metrics_listen));
  if (address.port == 0 || options.metrics_listen != options.server.listen_address) return absl::OkStatus();
  return absl::InvalidArgumentError("is the address of --listen: give another port");
}

absl::Status CheckLoadAddress(const ProgramOptions& options) {
  if (options.load_listen.empty()) return absl::OkStatus();
  EVPOSE_ASSIGN_OR_RETURN(const ListenAddress address, ParseListenAddress(options.load_listen));
  if (address.port == 0) return absl::OkStatus();
  for (const auto& [option, other] :
       {std::pair("--listen", options.server.listen_address), std::pair("--metrics-listen", options.metrics_listen)}) {
    if (options.load_listen != other) continue;
    return absl::InvalidArgumentError(absl::StrCat("is the address of ", option, ": give another port"));
  }
  return absl::OkStatus();
}

// Copies the values that have another form on the command line: durations in seconds, and a default that depends on
// other options.
void TakeValues(const Arguments& arguments, ServerOptions& options) {
  options.max_session_memory =
      arguments.max_session_memory.value_or(DefaultSessionMemory(options, AvailableMemoryBytes()));
  arguments.program.shutdown_notice = absl::Seconds(arguments.shutdown_notice_s);
  options.attach_timeout = absl::Seconds(arguments.attach_timeout_s);
  options.listener_timeout = absl::Seconds(arguments.listener_timeout_s);
  options.stream_idle_timeout = absl::Seconds(arguments.stream_idle_timeout_s);
  options.response_timeout = absl::Seconds(arguments.response_timeout_s);
  options.upload_timeout = absl::Seconds(arguments.upload_timeout_s);
  options.session_expiry = absl::Seconds(arguments.session_expiry_s);
  options.drain_timeout = absl::Seconds(arguments.shutdown_timeout_s);
}

}  // namespace

ParsedOptions ParseOptions(int argc, char** argv) {
  ParsedOptions parsed;
  Arguments arguments = {parsed.options};
  CLI::App app(kDescription, kProgram);
  try {
    DefineArguments(app, arguments);
    UseHelp(app);
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    const bool is_wrong = error.get_exit_code() != 0;
    if (is_wrong) std::cerr << UsageMessage(app, error) << std::endl;
    if (!is_wrong) app.exit(error);  // --help and --version, which it prints
    parsed.exit_status = is_wrong ? kWrongUsage : 0;
    return parsed;
  }
  TakeValues(arguments, parsed.options.server);
  return parsed;
}

void UseParser(const std::function<void(const CLI::App&)>& use) {
  ProgramOptions options;
  Arguments arguments = {options};
  CLI::App app(kDescription, kProgram);
  DefineArguments(app, arguments);
  UseHelp(app);
  use(app);
}

std::string WrongUsage(const ProgramOptions& options) {
  if (const absl::Status status = options.server.Validate(); !status.ok()) return InOptions(status);
  const std::pair<const char*, absl::Status> checks[] = {{"--store", CheckStore(options.server.store.store)},
                                                         {"--store-password-file", CheckStorePassword(options)},
                                                         {"--divide-store", CheckDivideStore(options)},
                                                         {"--metrics-listen", CheckMetricsAddress(options)},
                                                         {"--load-listen", CheckLoadAddress(options)},
                                                         {"--store-max-bytes", CheckStoreLimit(options.server.store)}};
  for (const auto& [option, status] : checks) {
    if (!status.ok()) return absl::StrCat(option, ": ", status.message());
  }
  if (const absl::Status status = CheckDuration("shutdown_notice", options.shutdown_notice); !status.ok()) {
    return InOptions(status);
  }
  const auto address = ParseListenAddress(options.server.listen_address);
  return address.ok() ? Exposure(options, *address) : std::string(address.status().message());
}

}  // namespace evpose::server
