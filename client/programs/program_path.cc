// SPDX-License-Identifier: Apache-2.0
#include "client/programs/program_path.h"

#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <system_error>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"

namespace evpose::client {

std::optional<std::string> FindProgram(const std::string& name, const std::string& in_build) {
  std::error_code error;
  std::vector<std::filesystem::path> directories;
  const std::filesystem::path own = std::filesystem::read_symlink("/proc/self/exe", error).parent_path();
  if (!error) directories = {own, own / in_build};
  const char* const path = std::getenv("PATH");
  for (const absl::string_view directory : absl::StrSplit(path == nullptr ? "" : path, ':', absl::SkipEmpty())) {
    directories.emplace_back(std::string(directory));
  }
  for (const std::filesystem::path& directory : directories) {
    const std::string program = (directory / name).string();
    if (std::filesystem::is_regular_file(program, error) && access(program.c_str(), X_OK) == 0) return program;
  }
  return std::nullopt;
}

std::string PathArgument(const std::string& path) {
  return absl::StartsWith(path, "-") ? absl::StrCat("./", path) : path;
}

}  // namespace evpose::client
