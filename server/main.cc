// evpose-server: see --help.
#include <grpc/support/log.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <iostream>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "core/base/output_file.h"
#include "server/rpc/listen_address.h"
#include "server/rpc/server.h"
#include "server/sessions/log.h"

namespace {

using evpose::server::ListenAddress;
using evpose::server::Server;
using evpose::server::ServerOptions;

constexpr int kFailed = 1;
constexpr int kWrongUsage = 2;

constexpr char kExample[] = R"(Example:
  evpose-server --listen 127.0.0.1:50051
then, elsewhere:
  evpose replay recording.raw --model model.obj --camera camera.yaml \
    --init-pose "tx ty tz qx qy qz qw" --server 127.0.0.1:50051

With port 0 a free port is taken. When the server is ready it prints one line on standard output,
"listening on HOST:PORT"; its log goes to standard error. SIGTERM or SIGINT lets clients finish for up to
--shutdown-timeout; a second one ends it at once.
)";

struct Arguments {
  ServerOptions options;
  std::string port_file;
  double session_expiry_s = absl::ToDoubleSeconds(ServerOptions().session_expiry);
  double shutdown_timeout_s = 10.0;
  bool insecure = false;
  std::string log_level = "info";
};

void DefineArguments(CLI::App& app, Arguments& arguments) {
  ServerOptions& options = arguments.options;
  options.listen_address = "127.0.0.1:50051";
  app.footer(kExample);
  app.set_version_flag("--version", EVPOSE_VERSION);
  app.option_defaults()->always_capture_default();
  app.add_option("--listen", options.listen_address, "HOST:PORT to listen on; port 0 takes a free one");
  app.add_option("--port-file", arguments.port_file, "write the port to this file when ready");
  app.add_flag("--insecure", arguments.insecure,
               "allow an address that other machines can reach: nothing is encrypted, and anybody may use the server");
  app.add_option("--workers", options.worker_threads, "threads that decode and track; 0: one per core");
  app.add_option("--max-sessions", options.max_sessions, "sessions at a time");
  app.add_option("--max-model-bytes", options.max_model_bytes, "of one model file");
  app.add_option("--max-model-store-bytes", options.max_model_store_bytes, "of all model files");
  app.add_option("--max-chunk-bytes", options.max_chunk_bytes, "of one chunk of events");
  app.add_option("--credit-bytes", options.credit_bytes, "bytes of events that may wait per session");
  app.add_option("--pose-log-capacity", options.pose_log_capacity, "poses kept per session");
  app.add_option("--session-expiry", arguments.session_expiry_s, "seconds after which a session without stream goes");
  app.add_option("--shutdown-timeout", arguments.shutdown_timeout_s, "seconds that streams get to finish")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--log-level", arguments.log_level, "debug, info, warning, error or off")
      ->check(CLI::IsMember({"debug", "info", "warning", "error", "off"}));
}

int Fail(int exit_status, const std::string& cause) {
  std::cerr << "evpose-server: " << cause << std::endl;
  return exit_status;
}

// gRPC's own log would break the rule of one line per event.
void LogOfGrpc(gpr_log_func_args* args) { spdlog::debug("grpc: {}", args->message); }

void SetUpLog(const std::string& level) {
  spdlog::set_default_logger(spdlog::stderr_logger_mt(evpose::server::kLogName));
  spdlog::set_pattern("%Y-%m-%dT%H:%M:%S.%e%z %l %v");
  spdlog::set_level(spdlog::level::from_str(level));
  gpr_set_log_function(LogOfGrpc);
}

sigset_t EndSignals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  return signals;
}

// Waits for the first signal; a second one then has its usual effect, the end.
int WaitForEndSignal() {
  const sigset_t signals = EndSignals();
  int signal_number = 0;
  sigwait(&signals, &signal_number);
  std::signal(SIGTERM, SIG_DFL);
  std::signal(SIGINT, SIG_DFL);
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
  return signal_number;
}

absl::Status WritePortFile(const std::string& path, int port) {
  return evpose::WriteFile(path, absl::StrCat(port, "\n"));
}

int Serve(const Arguments& arguments, const ListenAddress& address) {
  auto server = Server::Start(arguments.options);
  if (!server.ok()) return Fail(kFailed, std::string(server.status().message()));
  const std::string listening_on = address.WithPort((*server)->port());
  if (!arguments.port_file.empty()) {
    const absl::Status written = WritePortFile(arguments.port_file, (*server)->port());
    if (!written.ok()) return Fail(kFailed, std::string(written.message()));
  }
  spdlog::info("evpose-server {} is ready on {}", EVPOSE_VERSION, listening_on);
  std::cout << "listening on " << listening_on << std::endl;

  const int signal_number = WaitForEndSignal();
  spdlog::info("signal {}: leaving, streams have {} s to finish", signal_number, arguments.shutdown_timeout_s);
  (*server)->Shutdown(absl::Seconds(arguments.shutdown_timeout_s));
  spdlog::info("all streams are finished");
  return 0;
}

int Main(int argc, char** argv) {
  // Before any thread is made: all of them are to leave these to WaitForEndSignal.
  const sigset_t signals = EndSignals();
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);

  Arguments arguments;
  CLI::App app("Tracks objects in event streams: sessions over gRPC, poses out.", "evpose-server");
  try {
    DefineArguments(app, arguments);
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : kWrongUsage;
  }
  arguments.options.session_expiry = absl::Seconds(arguments.session_expiry_s);
  if (const absl::Status status = arguments.options.Validate(); !status.ok()) {
    return Fail(kWrongUsage, std::string(status.message()));
  }
  const auto address = evpose::server::ParseListenAddress(arguments.options.listen_address);
  if (!address.ok()) return Fail(kWrongUsage, std::string(address.status().message()));
  if (!address->IsLoopback() && !arguments.insecure) {
    return Fail(kWrongUsage, absl::StrCat("other machines can reach ", arguments.options.listen_address,
                                          ", and nothing is encrypted: listen on 127.0.0.1, or say --insecure"));
  }
  SetUpLog(arguments.log_level);
  return Serve(arguments, *address);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return Main(argc, argv);
  } catch (const std::exception& error) {
    return Fail(kFailed, error.what());
  }
}
