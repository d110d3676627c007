// SPDX-License-Identifier: Apache-2.0
#include "client/cli/file_arguments.h"

#include <filesystem>
#include <string>
#include <system_error>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "client/cli/common/command.h"
#include "core/base/status_macros.h"
#include "core/command_line/help_page.h"

namespace evpose::client {
namespace {

constexpr char kObjectFile[] = "ID=FILE";

// The values of --object, "ID=FILE", are divided at their first "=".
std::string BehindId(const std::string& value) { return value.substr(value.find('=') + 1); }

std::vector<std::string> ObjectIds(const CLI::App& command) {
  std::vector<std::string> ids;
  for (const CLI::Option* const option : command.get_options()) {
    if (option->get_type_name() != kObjectFile) continue;
    for (const std::string& value : option->results()) ids.push_back(value.substr(0, value.find('=')));
  }
  return ids;
}

// The files that a value names: {object} stands for the ID of each object, and FILE#cam1 is one of several cameras.
std::vector<std::string> FilesOf(const CLI::Option& option, const std::string& value,
                                 const std::vector<std::string>& ids) {
  const std::string path = option.get_type_name() == kObjectFile ? BehindId(value) : value;
  if (absl::StrContains(path, "{object}")) {
    std::vector<std::string> paths;
    for (const std::string& id : ids) paths.push_back(absl::StrReplaceAll(path, {{"{object}", id}}));
    return paths;
  }
  std::error_code error;
  return {std::filesystem::exists(path, error) ? path : path.substr(0, path.find('#'))};
}

// Returns whether the file is one that a command would read from the directory: one that exists there, unless it is a
// table of results at its top.
bool IsInputIn(const std::filesystem::path& directory, const std::filesystem::path& file) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error)) return false;
  const std::filesystem::path below = std::filesystem::relative(file, directory, error);
  if (error || below.empty() || *below.begin() == "..") return false;
  const bool is_result = below.extension() == ".json" || below.extension() == ".csv";
  return !is_result || below.has_parent_path() || below == "models.json";
}

// Returns a usage error if an output is an input file of a directory that an option names.
absl::Status CheckDirectories(const CLI::App& command, const std::vector<NamedFile>& outputs) {
  for (const CLI::Option* const option : command.get_options()) {
    if (option->get_group() != kInputGroup || !absl::StrContains(option->get_type_name(), "DIR")) continue;
    const std::string name = option->get_positional() ? PositionalName(*option) : option->get_name();
    for (const std::string& directory : option->results()) {
      for (const NamedFile& output : outputs) {
        if (!IsInputIn(directory, output.path)) continue;
        return UsageError(absl::StrCat(output.path, " is a file of ", name, " ", directory,
                                       ", which would be overwritten: give ", output.option, " another name"));
      }
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status CheckFileArguments(CLI::App& command) {
  const std::vector<std::string> ids = ObjectIds(command);
  std::vector<NamedFile> inputs, outputs;
  for (CLI::Option* const option : command.get_options()) {
    if (!absl::StrContains(option->get_type_name(), "FILE")) continue;
    const std::string name = option->get_positional() ? PositionalName(*option) : option->get_name();
    const bool is_output = IsOutputFile(*option);
    for (const std::string& value : option->results()) {
      for (const std::string& path : FilesOf(*option, value, ids)) {
        (is_output ? outputs : inputs).push_back({name, path});
      }
    }
  }
  EVPOSE_RETURN_IF_ERROR(CheckNothingIsOverwritten(inputs, outputs));
  return CheckDirectories(command, outputs);
}

}  // namespace evpose::client
