// SPDX-License-Identifier: Apache-2.0
#include "server/models/model_preparer.h"

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <system_error>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"
#include "core/base/status_macros.h"
#include "server/models/mesh_message.h"
#include "server/models/prepared_model.h"
#include "server/runtime/enum_number.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {
namespace {

// Period in which a waiting thread checks whether its call was cancelled: short against the seconds of a preparation.
constexpr int kCancellationPeriodMs = 50;
constexpr size_t kMaxTransferBytes = 1u << 20;

absl::Status SystemError(absl::string_view what, int error) {
  return absl::InternalError(absl::StrCat(what, ": ", std::generic_category().message(error)));
}

class InProcessPreparer : public ModelPreparer {
 public:
  absl::StatusOr<std::string> Prepare(const std::vector<uint8_t>& file, ModelFormat format, const ModelOptions& options,
                                      const Cancellation& cancellation) const override {
    EVPOSE_RETURN_IF_ERROR(cancellation.status());
    EVPOSE_ASSIGN_OR_RETURN(const ObjectModel model, ParseModelFile(file, format, options));
    return EncodePreparedModel(model);
  }
};

// A child process, whose standard input and output are one socket. The destructor kills it if it still runs.
class PreparationProcess {
 public:
  PreparationProcess() = default;
  PreparationProcess(const PreparationProcess&) = delete;
  PreparationProcess& operator=(const PreparationProcess&) = delete;
  ~PreparationProcess() {
    if (socket_ >= 0) close(socket_);
    if (pid_ <= 0) return;
    kill(pid_, SIGKILL);
    Wait();
  }

  absl::Status Start(std::vector<std::string> arguments) {
    int ends[2];
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) return SystemError("socketpair", errno);
    socket_ = ends[0];
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    const int error = Spawn(argv, ends[1]);
    close(ends[1]);
    return error == 0 ? absl::OkStatus() : SystemError(arguments[0], error);
  }

  // Sends the file, and receives everything that the process prints. Errors: the status of the cancellation.
  absl::StatusOr<std::string> Exchange(const std::vector<uint8_t>& file, const Cancellation& cancellation) {
    std::string output;
    std::string buffer(kMaxTransferBytes, '\0');
    size_t sent = 0;
    while (!cancellation.is_cancelled()) {
      if (sent == file.size()) shutdown(socket_, SHUT_WR);
      pollfd waited = {.fd = socket_, .events = POLLIN, .revents = 0};
      if (sent < file.size()) waited.events |= POLLOUT;
      if (poll(&waited, 1, kCancellationPeriodMs) <= 0) continue;
      if ((waited.revents & POLLOUT) != 0) {
        const size_t count = std::min(file.size() - sent, kMaxTransferBytes);
        const ssize_t done = send(socket_, file.data() + sent, count, MSG_NOSIGNAL | MSG_DONTWAIT);
        if (done > 0) sent += static_cast<size_t>(done);
        if (done < 0 && errno != EAGAIN && errno != EINTR) sent = file.size();  // the process has ended
      }
      if ((waited.revents & (POLLIN | POLLHUP | POLLERR)) == 0) continue;
      const ssize_t received = recv(socket_, buffer.data(), buffer.size(), MSG_DONTWAIT);
      if (received > 0) output.append(buffer.data(), static_cast<size_t>(received));
      if (received == 0 || (received < 0 && errno != EAGAIN && errno != EINTR)) return output;
    }
    return cancellation.status();
  }

  // The status of waitpid().
  int Wait() {
    int status = 0;
    while (waitpid(pid_, &status, 0) < 0 && errno == EINTR) continue;
    pid_ = 0;
    return status;
  }

 private:
  // The process has no descriptor of the server but standard error, and does not inherit its signal mask.
  int Spawn(const std::vector<char*>& argv, int socket) {
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, socket, STDIN_FILENO);
    posix_spawn_file_actions_adddup2(&actions, socket, STDOUT_FILENO);
    posix_spawn_file_actions_addclosefrom_np(&actions, STDERR_FILENO + 1);
    posix_spawnattr_t attributes;
    posix_spawnattr_init(&attributes);
    sigset_t signals;
    sigemptyset(&signals);
    posix_spawnattr_setsigmask(&attributes, &signals);
    sigaddset(&signals, SIGPIPE);
    posix_spawnattr_setsigdefault(&attributes, &signals);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
    char* const no_environment[] = {nullptr};
    const int error = posix_spawn(&pid_, argv[0], &actions, &attributes, argv.data(), no_environment);
    if (error != 0) pid_ = 0;
    posix_spawnattr_destroy(&attributes);
    posix_spawn_file_actions_destroy(&actions);
    return error;
  }

  int socket_ = -1;
  pid_t pid_ = 0;
};

class ChildPreparer : public ModelPreparer {
 public:
  ChildPreparer(std::string program, const PreparationBudget& budget) : program_(std::move(program)), budget_(budget) {}

  absl::StatusOr<std::string> Prepare(const std::vector<uint8_t>& file, ModelFormat format, const ModelOptions& options,
                                      const Cancellation& cancellation) const override {
    PreparationProcess process;
    EVPOSE_RETURN_IF_ERROR(process.Start(
        {program_, absl::StrCat(EnumNumber(format)), absl::StrFormat("%.17g", options.metres_per_unit),
         absl::StrFormat("%.17g", options.crease_angle_deg), options.is_smooth ? "1" : "0",
         absl::StrCat(options.max_bytes), absl::StrCat(budget_.cpu_seconds), absl::StrCat(budget_.memory_bytes)}));
    EVPOSE_ASSIGN_OR_RETURN(std::string output, process.Exchange(file, cancellation));
    const int status = process.Wait();
    return Result(std::move(output), status);
  }

 private:
  absl::StatusOr<std::string> Result(std::string output, int status) const {
    absl::string_view rest = output;
    absl::string_view step = "starting";
    while (absl::ConsumePrefix(&rest, kPreparationStep)) {
      const size_t end = std::min(rest.find('\n'), rest.size());
      step = rest.substr(0, end);
      rest.remove_prefix(std::min(end + 1, rest.size()));
    }
    const bool has_succeeded = WIFEXITED(status) && WEXITSTATUS(status) == 0;
    if (ConsumeModelLine(rest)) {
      if (has_succeeded) {
        output.erase(0, output.size() - rest.size());  // not copied: it may have more than 100 MB
        return output;
      }
      step = kPreparationViews;
    }
    if (has_succeeded && absl::ConsumePrefix(&rest, kPreparationError)) return absl::InvalidArgumentError(rest);
    // The kernel has killed the process, because the machine or the control group has no memory left: the model may be
    // prepared later.
    if (WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) return OutOfMemory();
    if (WIFSIGNALED(status) && WTERMSIG(status) == SIGXCPU) {
      return TooExpensive(step, absl::StrCat(budget_.cpu_seconds, " s of processor time"));
    }
    if (WIFEXITED(status) && WEXITSTATUS(status) == kPreparationOutOfMemory) {
      return TooExpensive(step, absl::StrCat(budget_.memory_bytes, " bytes of memory"));
    }
    return absl::InternalError(absl::StrCat("the preparation of the model ended unexpectedly while ", step, " (",
                                            WIFSIGNALED(status) ? "signal " : "exit status ",
                                            WIFSIGNALED(status) ? WTERMSIG(status) : WEXITSTATUS(status), ")"));
  }

  // Consumes the line that announces a model if all of the model follows.
  static bool ConsumeModelLine(absl::string_view& rest) {
    absl::string_view after = rest;
    if (!absl::ConsumePrefix(&after, kPreparationModel)) return false;
    const size_t end = after.find('\n');
    size_t size = 0;
    if (end == absl::string_view::npos || !absl::SimpleAtoi(after.substr(0, end), &size)) return false;
    after.remove_prefix(end + 1);
    if (after.size() < size) return false;
    rest = after;
    return true;
  }

  static absl::Status TooExpensive(absl::string_view step, absl::string_view budget) {
    return WithReason(absl::InvalidArgumentError(
                          absl::StrCat("the model takes more than ", budget, " while ", step,
                                       ": simplify it, or start the server with a larger --model-cpu-seconds or "
                                       "--model-memory")),
                      v1::MODEL_TOO_EXPENSIVE, {{"step", std::string(step)}});
  }

  const std::string program_;
  const PreparationBudget budget_;
};

}  // namespace

std::unique_ptr<ModelPreparer> MakeModelPreparer() { return std::make_unique<InProcessPreparer>(); }

std::unique_ptr<ModelPreparer> MakeChildModelPreparer(const std::string& program, const PreparationBudget& budget) {
  return std::make_unique<ChildPreparer>(program, budget);
}

}  // namespace evpose::server
