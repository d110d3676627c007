// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/server_process.h"

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <optional>
#include <system_error>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "client/programs/program_path.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr char kProgram[] = "evpose-server";

absl::StatusOr<std::string> FindServer() {
  const std::optional<std::string> program = FindProgram(kProgram, "../../server");
  if (program.has_value()) return *program;
  return absl::NotFoundError(absl::StrCat("there is no ", kProgram,
                                          " beside evpose nor in the PATH: install it there, or give --server "
                                          "HOST:PORT of one that runs"));
}

std::vector<char*> Pointers(std::vector<std::string>& texts) {
  std::vector<char*> pointers;
  for (std::string& text : texts) pointers.push_back(text.data());
  pointers.push_back(nullptr);
  return pointers;
}

// Returns the environment without the variables EVPOSE_*, which configure a service on this machine.
std::vector<std::string> Environment() {
  std::vector<std::string> variables;
  for (char** variable = environ; *variable != nullptr; ++variable) {
    if (!absl::StartsWith(*variable, "EVPOSE_")) variables.emplace_back(*variable);
  }
  return variables;
}

// Runs in the child process, where only async-signal-safe functions are allowed. The process gets a group of its own,
// so that an interrupt from the terminal reaches only the parent.
[[noreturn]] void Execute(const std::string& program, char* const* arguments, char* const* environment, int output,
                          pid_t parent) {
  setpgid(0, 0);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(1);  // the parent has already ended
  dup2(output, STDOUT_FILENO);
  execve(program.c_str(), arguments, environment);
  _exit(127);
}

// Returns the bytes before the next line feed, or before the end of the pipe.
std::string ReadLine(int descriptor) {
  std::string line;
  char next = 0;
  while (true) {
    const ssize_t count = read(descriptor, &next, 1);
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0 || next == '\n') return line;
    line.push_back(next);
  }
}

}  // namespace

absl::StatusOr<std::unique_ptr<ServerProcess>> ServerProcess::Start(const std::vector<std::string>& arguments) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string program, FindServer());
  std::vector<std::string> words = {program, "--listen", "127.0.0.1:0", "--store", "memory", "--log-level", "error"};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<std::string> variables = Environment();
  const std::vector<char*> argv = Pointers(words);
  const std::vector<char*> envp = Pointers(variables);
  int pipe_ends[2] = {};
  if (pipe2(pipe_ends, O_CLOEXEC) != 0)
    return absl::InternalError(absl::StrCat("no pipe: ", std::generic_category().message(errno)));
  const pid_t parent = getpid();
  const pid_t pid = fork();
  if (pid == 0) Execute(program, argv.data(), envp.data(), pipe_ends[1], parent);
  const int fork_error = errno;
  close(pipe_ends[1]);
  if (pid < 0) {
    close(pipe_ends[0]);
    return absl::InternalError(
        absl::StrCat(program, " cannot be started: ", std::generic_category().message(fork_error)));
  }
  std::unique_ptr<ServerProcess> process(new ServerProcess(pid, pipe_ends[0]));
  const std::string line = ReadLine(pipe_ends[0]);
  absl::string_view address = line;
  if (!absl::ConsumePrefix(&address, "listening on ")) {
    return absl::UnavailableError(absl::StrCat(program,
                                               " has ended before it could be reached; give --server "
                                               "HOST:PORT of one that runs"));
  }
  process->address_ = std::string(address);
  return process;
}

ServerProcess::~ServerProcess() {
  kill(pid_, SIGKILL);
  while (waitpid(pid_, nullptr, 0) < 0 && errno == EINTR) continue;
  close(output_);
}

}  // namespace evpose::client
