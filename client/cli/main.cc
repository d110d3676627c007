// SPDX-License-Identifier: Apache-2.0
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdlib>
#include <iostream>
#include <set>
#include <string>
#include <vector>

#include "client/cli/cli.h"
#include "client/cli/console/standard_streams.h"
#include "core/base/temporary_files.h"
#include "core/base/terminate_by_signal.h"
#include "core/command_line/help.h"

namespace {

// Read by threads other than the one that handles the signal.
std::atomic<int> g_interrupts = 0;
static_assert(std::atomic<int>::is_always_lock_free, "a signal handler must not lock");

void Terminate(int signal) {
  evpose::RemoveTemporaryFiles();
  evpose::TerminateBySignal(signal);
}

// The first signal requests a clean end, at which the poses so far are written. The second ends the process.
// A terminal that is closed sends SIGHUP twice, through its shell and to its processes.
void HandleInterrupt(int signal) {
  if (++g_interrupts > 1 && signal != SIGHUP) Terminate(signal);
}

void HandleEndSignals(void (*handle)(int)) {
  std::signal(SIGINT, handle);
  std::signal(SIGTERM, handle);
  // nohup has set SIGHUP to be ignored.
  if (std::signal(SIGHUP, handle) == SIG_IGN) std::signal(SIGHUP, SIG_IGN);
}

}  // namespace

int main(int argc, char** argv) {
  evpose::client::OpenStandardStreams();
  // These commands end with a message. An interrupt ends the others at once. All leave complete files or none.
  const std::string command = argc > 1 ? argv[1] : "";
  const std::string bench = command == "bench" && argc > 2 ? argv[2] : "";
  const std::set<std::string> clean = {"convert", "render", "replay", "simulate", "stream", "view", "watch"};
  if (clean.count(command) > 0 || bench == "load" || bench == "speed" || bench == "synthetic") {
    HandleEndSignals(HandleInterrupt);
  } else {
    HandleEndSignals(Terminate);
  }
  // The error message of evpose has the cause of a failed connection, which gRPC would log several times.
  // NOLINTNEXTLINE(concurrency-mt-unsafe): no other thread runs yet
  setenv("GRPC_VERBOSITY", "NONE", 0);
  std::signal(SIGPIPE, SIG_IGN);  // a closed pipe is an error of the write
  std::ios::sync_with_stdio(false);
  // Log of a server in this process, on standard error: standard output is for the results of the command.
  spdlog::set_default_logger(spdlog::stderr_color_mt("evpose"));
  spdlog::set_level(spdlog::level::warn);
  evpose::client::CliContext context{std::cout, std::cerr};
  // NOLINTNEXTLINE(concurrency-mt-unsafe): nothing changes the environment after the start
  const char* const terminal = std::getenv("TERM");
  context.is_err_terminal = isatty(STDERR_FILENO) != 0 && terminal != nullptr && std::string(terminal) != "dumb";
  context.err_columns = evpose::TerminalColumns(STDERR_FILENO);
  context.is_interrupted = [] { return g_interrupts > 0; };
  return evpose::client::RunCli(std::vector<std::string>(argv + 1, argv + argc), context);
}
