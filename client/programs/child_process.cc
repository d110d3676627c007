// SPDX-License-Identifier: Apache-2.0
#include "client/programs/child_process.h"

#include <spawn.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <filesystem>
#include <system_error>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"

namespace evpose::client {
namespace {

// Number of bytes that are read from the end of the program's standard error.
constexpr off_t kMaxErrorBytes = off_t{64} * 1024;

// The last line that is not empty, without the name of the program at its beginning.
std::string LastLine(absl::string_view text, absl::string_view program) {
  text = absl::StripTrailingAsciiWhitespace(text);
  const size_t end_of_others = text.rfind('\n');
  if (end_of_others != absl::string_view::npos) text.remove_prefix(end_of_others + 1);
  absl::ConsumePrefix(&text, absl::StrCat(program, ": "));
  return std::string(text);
}

std::string EndOfFile(int descriptor) {
  const off_t size = std::max<off_t>(0, lseek(descriptor, 0, SEEK_END));
  std::string text(static_cast<size_t>(std::min(size, kMaxErrorBytes)), '\0');
  const ssize_t count = pread(descriptor, text.data(), text.size(), size - static_cast<off_t>(text.size()));
  text.resize(static_cast<size_t>(std::max<ssize_t>(0, count)));
  return text;
}

}  // namespace

absl::StatusOr<std::unique_ptr<ChildProcess>> ChildProcess::Start(const std::string& path,
                                                                  const std::vector<std::string>& arguments) {
  const auto error = [&path](int number) {
    return absl::InternalError(absl::StrCat(path, " cannot be started: ", std::generic_category().message(number)));
  };
  int channels[2];
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, channels) != 0) return error(errno);
  const int errors = memfd_create("errors", MFD_CLOEXEC);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, channels[1], STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, channels[1], STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, errors, STDERR_FILENO);
  std::vector<std::string> words = {path};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> pointers;
  for (std::string& word : words) pointers.push_back(word.data());
  pointers.push_back(nullptr);
  pid_t pid = -1;
  const int result = posix_spawn(&pid, path.c_str(), &actions, nullptr, pointers.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(channels[1]);
  if (result != 0) {
    close(channels[0]);
    close(errors);
    return error(result);
  }
  return std::unique_ptr<ChildProcess>(
      new ChildProcess(std::filesystem::path(path).filename().string(), pid, channels[0], errors));
}

ChildProcess::~ChildProcess() {
  if (pid_ >= 0) {
    kill(pid_, SIGKILL);
    (void)Wait();
  }
  close(channel_);
  close(errors_);
}

absl::StatusOr<size_t> ChildProcess::Read(absl::Span<uint8_t> buffer) {
  while (true) {
    const ssize_t count = read(channel_, buffer.data(), buffer.size());
    if (count >= 0) return static_cast<size_t>(count);
    // A program that ends with input that it has not read resets the connection.
    if (errno == ECONNRESET) return 0;
    if (errno != EINTR) return absl::ErrnoToStatus(errno, absl::StrCat("the output of ", name_, " cannot be read"));
  }
}

absl::Status ChildProcess::Write(absl::Span<const uint8_t> bytes) {
  while (!bytes.empty()) {
    const ssize_t count = send(channel_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (count >= 0) {
      bytes.remove_prefix(static_cast<size_t>(count));
    } else if (errno != EINTR) {
      const int number = errno;
      if (const absl::Status ended = Wait(); !ended.ok()) return ended;
      return absl::UnavailableError(
          absl::StrCat(name_, " does not take its input: ", std::generic_category().message(number)));
    }
  }
  return absl::OkStatus();
}

absl::Status ChildProcess::Wait() {
  if (pid_ < 0) return end_;
  shutdown(channel_, SHUT_WR);
  int status = 0;
  while (waitpid(pid_, &status, 0) < 0 && errno == EINTR) continue;
  pid_ = -1;
  if (WIFEXITED(status) && WEXITSTATUS(status) != 0) {
    end_ = absl::InvalidArgumentError(LastLine(ErrorText(), name_));
  } else if (!WIFEXITED(status)) {
    end_ = absl::InternalError(absl::StrCat(name_, " was ended by signal ", WTERMSIG(status)));
  }
  return end_;
}

std::string ChildProcess::ErrorText() const { return EndOfFile(errors_); }

}  // namespace evpose::client
