// SPDX-License-Identifier: Apache-2.0

// evpose-server: see --help.
#include <grpc/support/log.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>
#include <filesystem>
#include <future>
#include <iostream>
#include <memory>
#include <string>
#include <system_error>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "core/base/output_file.h"
#include "core/base/terminate_by_signal.h"
#include "core/base/version.h"
#include "server/auth/token_file.h"
#include "server/connections/listen_address.h"
#include "server/http/load_listener.h"
#include "server/http/operator_pages.h"
#include "server/program/options.h"
#include "server/program/tenant_limits.h"
#include "server/program/thread_check.h"
#include "server/rpc/server.h"
#include "server/runtime/out_of_memory.h"
#include "server/stores/open_store.h"
#include "server/telemetry/log.h"

namespace evpose::server {
namespace {

constexpr int kFailed = 1;
// Time beyond the notice and the drain after which a shutdown that does not end is cut off. It allows for the last
// commits to the store.
constexpr absl::Duration kStalledShutdownGrace = absl::Seconds(5);

// Writes one line with the cause at every log level; as a JSON object if the log is JSON, so that a collector can parse
// it.
int Fail(int exit_status, const std::string& cause) {
  if (CurrentLogFormat() == LogFormat::kJson) {
    SetLogLevel(LogLevel::kError);
    Log(LogLevel::kError, "server_failed", {{"message", cause}});
    return exit_status;
  }
  std::cerr << "evpose-server: " << cause << std::endl;
  return exit_status;
}

// Flushes standard output, and returns the exit status.
int FlushOutput() {
  if (std::cout.flush()) return 0;
  return Fail(kFailed, "standard output could not be written: the disk is full, or the reader has closed the pipe");
}

// Redirects the log of gRPC, whose own output has another format, to the server's log.
void LogOfGrpc(gpr_log_func_args* args) { Log(LogLevel::kDebug, "grpc", {{"message", args->message}}); }

sigset_t EndSignals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  return signals;
}

// The signal with which a Drain call wakes the main thread. It stays blocked, so it never ends the process.
int DrainSignal() { return SIGRTMIN; }

// The signal that ends a StartWatch.
int StartedSignal() { return SIGRTMIN + 1; }

void BlockSignals() {
  sigset_t signals = EndSignals();
  sigaddset(&signals, DrainSignal());
  sigaddset(&signals, StartedSignal());
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
}

// While it exists, a signal ends the process at once: during the start, which may wait for the store, there are no
// streams to finish. A signal that comes later waits for WaitForEndSignal().
class StartWatch {
 public:
  StartWatch() = default;
  ~StartWatch() {
    pthread_kill(thread_.native_handle(), StartedSignal());
    thread_.join();
  }
  StartWatch(const StartWatch&) = delete;
  StartWatch& operator=(const StartWatch&) = delete;

 private:
  static void Watch() {
    sigset_t signals = EndSignals();
    sigaddset(&signals, StartedSignal());
    int signal_number = 0;
    sigwait(&signals, &signal_number);
    if (signal_number == StartedSignal()) return;
    Log(LogLevel::kInfo, "server_stopped", {{"message", absl::StrCat("signal ", signal_number, " ended the start")}});
    TerminateBySignal(signal_number);
  }

  std::thread thread_{Watch};
};

absl::StatusOr<std::unique_ptr<Server>> StartServer(const ServerOptions& options) {
  const StartWatch watch;
  return Server::Start(options);
}

// Waits for the first signal or Drain call. Afterwards a further signal ends the process immediately.
int WaitForEndSignal() {
  const sigset_t signals = EndSignals();
  sigset_t reasons = signals;
  sigaddset(&reasons, DrainSignal());
  int signal_number = 0;
  sigwait(&reasons, &signal_number);
  std::signal(SIGTERM, TerminateBySignal);
  std::signal(SIGINT, TerminateBySignal);
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
  return signal_number;
}

// Waits for the shutdown notice, in which load balancers detect that the server is shutting down; clients are served as
// before. A Drain call ends the wait early; a signal ends the process. Returns whether Drain was called.
bool WaitForBalancers(absl::Duration notice) {
  sigset_t drain;
  sigemptyset(&drain);
  sigaddset(&drain, DrainSignal());
  const timespec timeout = absl::ToTimespec(notice);
  int received = -1;
  do {
    received = sigtimedwait(&drain, nullptr, &timeout);
  } while (received < 0 && errno == EINTR);
  return received == DrainSignal();
}

absl::Status WritePortFile(const std::string& path, int port) { return WriteFile(path, absl::StrCat(port, "\n")); }

// Prints the token on standard output and the instructions on standard error, so that a script can redirect the token.
int PrintNewToken(const ProgramOptions& options) {
  const auto made = MakeToken(options.new_token, options.is_operator);
  if (!made.ok()) return Fail(kWrongUsage, absl::StrCat("--new-token: ", made.status().message()));
  const std::string& path = options.server.token_file;
  if (!path.empty()) {
    const absl::Status added = AppendTokenLine(path, made->line);
    if (!added.ok()) return Fail(kFailed, std::string(added.message()));
  }
  std::cerr << "The token, a secret that is shown only once; clients read it with --token-file:\n" << std::flush;
  std::cout << made->token << std::endl;
  if (!std::cout) {
    return Fail(kFailed, absl::StrCat("the token could not be written to standard output and is lost",
                                      path.empty() ? "" : ": remove its line, the last one, from ", path));
  }
  if (path.empty()) {
    std::cerr << "Its line for the server's --token-file:\n" << made->line << std::endl;
  } else {
    std::cerr << "Its line was added to " << path << std::endl;
  }
  return 0;
}

// Null without --metrics-listen.
absl::StatusOr<std::unique_ptr<OperatorPages>> StartPages(const ProgramOptions& options) {
  if (options.metrics_listen.empty()) return nullptr;
  auto pages = OperatorPages::Start(options.metrics_listen, ThisBuild());
  if (!pages.ok()) return absl::UnavailableError(absl::StrCat("--metrics-listen: ", pages.status().message()));
  return pages;
}

// Null without --load-listen.
absl::StatusOr<std::unique_ptr<LoadListener>> StartLoadListener(const ProgramOptions& options, const Server& server) {
  if (options.load_listen.empty()) return nullptr;
  auto listener = LoadListener::Start(options.load_listen, [&server] { return AgentLine(server.load_ratio()); });
  if (!listener.ok()) return absl::UnavailableError(absl::StrCat("--load-listen: ", listener.status().message()));
  return listener;
}

// Prints the addresses on standard output. A program that starts the server may wait for these lines.
void Announce(const ProgramOptions& options, const std::string& listening_on, const OperatorPages* pages,
              const LoadListener* load) {
  std::cout << "listening on " << listening_on << "\n";
  if (pages != nullptr) {
    const ListenAddress address = *ParseListenAddress(options.metrics_listen);
    const std::string metrics_on = address.WithPort(pages->port());
    Log(LogLevel::kInfo, "metrics_ready",
        {{"message", absl::StrCat("http://", metrics_on, "/metrics, /healthz, /readyz")}});
    std::cout << "metrics on " << metrics_on << "\n";
  }
  if (load != nullptr) {
    std::cout << "load on " << ParseListenAddress(options.load_listen)->WithPort(load->port()) << "\n";
  }
  std::cout << std::flush;
}

// Raises the limit of open files to its maximum. Each connection needs a descriptor, and the usual limit of 1024 exists
// for programs that use select().
void AllowAllDescriptors() {
  rlimit limit;
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  setrlimit(RLIMIT_NOFILE, &limit);
}

// The threads of the server beside its workers and those for slow work: those of gRPC, the store, the pages, the load
// and slow work that takes long.
constexpr int kOtherThreads = 34;

absl::Status CheckThreads(const ServerOptions& options) {
  const int cores = static_cast<int>(std::thread::hardware_concurrency());
  const int workers = options.worker_threads > 0 ? options.worker_threads : cores;
  return CheckThreadsCanBeMade(workers + 3 * options.slow_threads + kOtherThreads);
}

void LogTenantLimits(const ServerOptions::TenantLimits& limits) {
  Log(LogLevel::kInfo, "tenant_limits",
      {{"max_sessions", limits.max_sessions.value_or(0)},
       {"max_session_memory", limits.max_session_memory.value_or(0)},
       {"max_model_bytes", limits.max_model_bytes.value_or(0)},
       {"max_uploads", limits.max_uploads.value_or(0)},
       {"max_streams", limits.max_streams.value_or(0)},
       {"max_watchers", limits.max_watchers.value_or(0)},
       {"max_bytes_per_s", limits.max_bytes_per_s.value_or(0)},
       {"max_cpu", absl::StrCat(limits.max_cpu.value_or(0.0))},  // the log has no fractions
       {"max_health_per_s", limits.max_health_per_s}});
}

// The path of another program of this installation, which is in the same folder as this one.
std::string ProgramBeside(const std::string& name) {
  std::error_code error;  // without /proc the path is the name alone, which the server then reports
  return (std::filesystem::read_symlink("/proc/self/exe", error).parent_path() / name).string();
}

void LogReady(const std::string& address, const StoreOptions& store) {
  const BuildVersion build = ThisBuild();
  Log(LogLevel::kInfo, "server_ready",
      {{"address", address}, {"store", StoreForLog(store)}, {"version", build.version}, {"commit", build.commit}});
}

int Serve(const ProgramOptions& options) {
  AllowAllDescriptors();
  PrepareForOutOfMemory();
  ServerOptions server_options = options.server;
  server_options.tenant = EffectiveTenantLimits(server_options);
  if (HasTenants(server_options)) LogTenantLimits(server_options.tenant);
  if (const absl::Status status = CheckThreads(server_options); !status.ok()) {
    return Fail(kFailed, std::string(status.message()));
  }
  server_options.model_preparer = ProgramBeside("evpose-prepare-model");
  std::promise<absl::Duration> drained;
  server_options.on_drain = [&drained](absl::Duration deadline) {
    drained.set_value(deadline);
    kill(getpid(), DrainSignal());
  };
  // As at SIGTERM the streams continue elsewhere, but the exit status makes a supervisor start the server again.
  std::atomic<bool> is_stalled = false;
  const absl::Duration last_moment = options.shutdown_notice + server_options.drain_timeout + kStalledShutdownGrace;
  server_options.on_stalled = [&is_stalled, last_moment] {
    is_stalled = true;
    kill(getpid(), SIGTERM);
    // The shutdown waits for the thread that accepts connections, which may never return.
    std::thread([last_moment] {
      absl::SleepFor(last_moment);
      _exit(kFailed);
    }).detach();
  };
  // The pages are started before the server, so that its start can be observed, and are destroyed before it.
  absl::StatusOr<std::unique_ptr<Server>> server;
  const auto pages = StartPages(options);
  if (!pages.ok()) return Fail(kFailed, std::string(pages.status().message()));
  server = StartServer(server_options);
  if (!server.ok()) return Fail(kFailed, std::string(server.status().message()));
  if (*pages != nullptr) (*pages)->Show(**server);
  const auto load = StartLoadListener(options, **server);
  if (!load.ok()) return Fail(kFailed, std::string(load.status().message()));
  const std::string listening_on = ParseListenAddress(server_options.listen_address)->WithPort((*server)->port());
  if (!options.port_file.empty()) {
    const absl::Status written = WritePortFile(options.port_file, (*server)->port());
    if (!written.ok()) return Fail(kFailed, std::string(written.message()));
  }
  LogReady(listening_on, server_options.store);
  Announce(options, listening_on, pages->get(), load->get());

  const int signal_number = WaitForEndSignal();
  bool was_drain_called = signal_number == DrainSignal();
  if (!was_drain_called && options.shutdown_notice > absl::ZeroDuration()) {
    Log(LogLevel::kInfo, "server_leaving",
        {{"why", absl::StrCat("signal ", signal_number)}, {"notice", absl::FormatDuration(options.shutdown_notice)}});
    (*server)->AnnounceShutdown();
    was_drain_called = WaitForBalancers(options.shutdown_notice);
  }
  const absl::Duration deadline = was_drain_called ? drained.get_future().get() : server_options.drain_timeout;
  Log(LogLevel::kInfo, "server_draining",
      {{"why", was_drain_called ? "Drain was called" : absl::StrCat("signal ", signal_number)},
       {"timeout", absl::FormatDuration(deadline)}});
  (*server)->Shutdown(deadline);
  Log(LogLevel::kInfo, "server_stopped", {{"message", "all streams are finished"}});
  return is_stalled ? kFailed : 0;
}

// --divide-store.
int PrintMoves(const StoreOptions& options) {
  const absl::Status divided = DivideStore(options, [](const std::string& line) { std::cout << line << std::endl; });
  return divided.ok() ? 0 : Fail(kFailed, absl::StrCat("--divide-store: ", divided.message()));
}

int Main(int argc, char** argv) {
  // The signals are blocked before any thread is created, because all threads must leave them to WaitForEndSignal().
  BlockSignals();

  ParsedOptions parsed = ParseOptions(argc, argv);
  if (parsed.exit_status.has_value()) return *parsed.exit_status == 0 ? FlushOutput() : *parsed.exit_status;
  ProgramOptions& options = parsed.options;
  if (!options.new_token.empty()) return PrintNewToken(options);
  if (const std::string wrong = WrongUsage(options); !wrong.empty()) {
    return Fail(kWrongUsage, absl::StrCat(wrong, "; evpose-server --help lists the options"));
  }
  SetUpLog(*ParseLogFormat(options.log_format), *ParseLogLevel(options.log_level));
  gpr_set_log_function(LogOfGrpc);
  if (const absl::Status completed = CompleteStore(options); !completed.ok()) {
    return Fail(kFailed, std::string(completed.message()));
  }
  return options.divides_store ? PrintMoves(options.server.store) : Serve(options);
}

}  // namespace
}  // namespace evpose::server

int main(int argc, char** argv) {
  try {
    return evpose::server::Main(argc, argv);
  } catch (const std::exception& error) {
    return evpose::server::Fail(evpose::server::kFailed, error.what());
  }
}
