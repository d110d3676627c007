// SPDX-License-Identifier: Apache-2.0
#include "client/bench/gnuplot.h"

#include <fcntl.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "absl/types/span.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// A file without a name, in memory. The program's three streams are such files: however much it reads and writes, in
// whatever order, neither side waits for the other, as they might over pipes.
class MemoryFile {
 public:
  static absl::StatusOr<MemoryFile> Create() {
    const int descriptor = memfd_create("gnuplot", MFD_CLOEXEC);
    if (descriptor < 0) return absl::ErrnoToStatus(errno, "gnuplot: no memory for its input and output");
    return MemoryFile(descriptor);
  }
  MemoryFile(MemoryFile&& other) noexcept : descriptor_(std::exchange(other.descriptor_, -1)) {}
  MemoryFile& operator=(MemoryFile&&) = delete;
  ~MemoryFile() {
    if (descriptor_ >= 0) close(descriptor_);
  }

  int descriptor() const { return descriptor_; }

  // From its beginning; it is read from there, too.
  absl::Status Write(absl::Span<const char> bytes) {
    for (size_t done = 0; done < bytes.size();) {
      const ssize_t size = pwrite(descriptor_, bytes.data() + done, bytes.size() - done, static_cast<off_t>(done));
      if (size < 0 && errno == EINTR) continue;
      if (size <= 0) return absl::ErrnoToStatus(errno, "gnuplot: no memory for its input");
      done += static_cast<size_t>(size);
    }
    return absl::OkStatus();
  }

  absl::StatusOr<std::string> Read() const {
    std::string contents;
    std::array<char, 1 << 16> buffer;
    while (true) {
      const ssize_t size = pread(descriptor_, buffer.data(), buffer.size(), static_cast<off_t>(contents.size()));
      if (size < 0 && errno == EINTR) continue;
      if (size < 0) return absl::ErrnoToStatus(errno, "gnuplot: its output cannot be read");
      if (size == 0) return contents;
      contents.append(buffer.data(), static_cast<size_t>(size));
    }
  }

 private:
  explicit MemoryFile(int descriptor) : descriptor_(descriptor) {}

  int descriptor_;
};

absl::StatusOr<pid_t> Spawn(const MemoryFile& in, const MemoryFile& out, const MemoryFile& err) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, in.descriptor(), STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, out.descriptor(), STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, err.descriptor(), STDERR_FILENO);
  std::string name = "gnuplot";
  std::string without_start_up_files = "-d";
  std::array<char*, 3> arguments = {name.data(), without_start_up_files.data(), nullptr};
  pid_t pid = -1;
  const int error = posix_spawnp(&pid, name.c_str(), &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error == 0) return pid;
  if (error == ENOENT) {
    return absl::FailedPreconditionError(
        "the program gnuplot, which draws the pictures, is not there: install Debian's package gnuplot-nox");
  }
  return absl::ErrnoToStatus(error, "gnuplot cannot be started");
}

// gnuplot repeats the command that it fails on, and points at the place with a ^, before it says why.
std::string LastLine(const std::string& text) {
  const absl::string_view stripped = absl::StripTrailingAsciiWhitespace(text);
  const size_t newline = stripped.rfind('\n');
  return std::string(
      absl::StripAsciiWhitespace(newline == absl::string_view::npos ? stripped : stripped.substr(newline)));
}

}  // namespace

absl::StatusOr<std::string> RunGnuplot(const std::string& script) {
  EVPOSE_ASSIGN_OR_RETURN(MemoryFile in, MemoryFile::Create());
  EVPOSE_ASSIGN_OR_RETURN(const MemoryFile out, MemoryFile::Create());
  EVPOSE_ASSIGN_OR_RETURN(const MemoryFile err, MemoryFile::Create());
  EVPOSE_RETURN_IF_ERROR(in.Write(script));
  EVPOSE_ASSIGN_OR_RETURN(const pid_t pid, Spawn(in, out, err));
  int state = 0;
  while (waitpid(pid, &state, 0) < 0) {
    if (errno != EINTR) return absl::ErrnoToStatus(errno, "gnuplot: lost sight of it");
  }
  if (!WIFEXITED(state) || WEXITSTATUS(state) != 0) {
    EVPOSE_ASSIGN_OR_RETURN(const std::string message, err.Read());
    const std::string end =
        WIFEXITED(state) ? absl::StrCat("exit status ", WEXITSTATUS(state)) : absl::StrCat("signal ", WTERMSIG(state));
    return absl::InternalError(absl::StrCat("gnuplot failed (", end, "): ", LastLine(message)));
  }
  return out.Read();
}

std::string GnuplotQuoted(const std::string& text) {
  std::string quoted = "'";
  for (const char c : text) {
    if (c == '\'') quoted += '\'';
    quoted += static_cast<unsigned char>(c) < 0x20 || c == 0x7F ? ' ' : c;
  }
  return quoted + "'";
}

}  // namespace evpose::client
