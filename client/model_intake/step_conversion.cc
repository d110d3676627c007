// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/step_conversion.h"

#include <spawn.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <optional>
#include <system_error>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"
#include "client/model_intake/program_path.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr char kConverter[] = "evpose-convert-step";

// A file without a name, in memory, that a child process writes.
class MemoryFile {
 public:
  MemoryFile() : descriptor_(memfd_create(kConverter, MFD_CLOEXEC)) {}
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;
  ~MemoryFile() {
    if (descriptor_ >= 0) close(descriptor_);
  }

  int descriptor() const { return descriptor_; }
  std::string Contents() const {
    std::string contents(static_cast<size_t>(std::max<off_t>(0, lseek(descriptor_, 0, SEEK_END))), '\0');
    size_t size = 0;
    while (size < contents.size()) {
      const ssize_t count =
          pread(descriptor_, contents.data() + size, contents.size() - size, static_cast<off_t>(size));
      if (count <= 0) break;
      size += static_cast<size_t>(count);
    }
    contents.resize(size);
    return contents;
  }

 private:
  const int descriptor_;
};

// The last line that is not empty, without the name of the program at its beginning.
std::string LastLine(absl::string_view text) {
  text = absl::StripTrailingAsciiWhitespace(text);
  const size_t end_of_others = text.rfind('\n');
  if (end_of_others != absl::string_view::npos) text.remove_prefix(end_of_others + 1);
  absl::ConsumePrefix(&text, absl::StrCat(kConverter, ": "));
  return std::string(text);
}

}  // namespace

absl::StatusOr<std::string> RunConverter(const std::string& program, const std::string& path) {
  const MemoryFile output, errors;
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, output.descriptor(), STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, errors.descriptor(), STDERR_FILENO);
  std::string words[] = {program, path};
  char* const arguments[] = {words[0].data(), words[1].data(), nullptr};
  pid_t pid = 0;
  const int error = posix_spawn(&pid, program.c_str(), &actions, nullptr, arguments, environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) {
    return absl::InternalError(absl::StrCat(program, " cannot be started: ", std::generic_category().message(error)));
  }
  int status = 0;
  while (waitpid(pid, &status, 0) < 0 && errno == EINTR) continue;
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return output.Contents();
  if (WIFEXITED(status)) return absl::InvalidArgumentError(LastLine(errors.Contents()));
  return absl::InternalError(absl::StrCat(program, " was ended by signal ", WTERMSIG(status)));
}

absl::StatusOr<std::string> ConvertStep(const std::string& path) {
  EVPOSE_RETURN_IF_ERROR(CheckIsFile(path));
  const std::optional<std::string> program = FindProgram(kConverter, "../convert_step");
  if (program.has_value()) return RunConverter(*program, path);
  return absl::FailedPreconditionError(
      absl::StrCat("STEP and IGES files need the program ", kConverter,
                   ", which is neither beside this program nor in the PATH: install the Debian package ", kConverter,
                   " (component step of cmake --install), or export the model as STL, 3MF or glTF"));
}

}  // namespace evpose::client
