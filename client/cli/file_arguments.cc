// SPDX-License-Identifier: Apache-2.0
#include "client/cli/file_arguments.h"

#include <filesystem>
#include <string>
#include <system_error>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_replace.h"
#include "client/cli/common/command.h"
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

}  // namespace

absl::Status CheckFileArguments(CLI::App& command) {
  const std::vector<std::string> ids = ObjectIds(command);
  std::vector<NamedFile> inputs, outputs;
  for (CLI::Option* const option : command.get_options()) {
    if (!absl::StrContains(option->get_type_name(), "FILE")) continue;
    const std::string name = option->get_positional() ? PositionalName(*option) : option->get_name();
    const bool is_output = IsOutputFile(*option);
    for (const std::string& value : option->results()) {
      if (is_output && value == "-") continue;
      for (const std::string& path : FilesOf(*option, value, ids)) {
        (is_output ? outputs : inputs).push_back({name, path});
      }
    }
  }
  return CheckNothingIsOverwritten(inputs, outputs);
}

}  // namespace evpose::client
