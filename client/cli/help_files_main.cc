// SPDX-License-Identifier: Apache-2.0

// evpose-help-files: writes the manual pages and the shell completion of the programs that users call to a directory,
// during the build.
#include <algorithm>
#include <filesystem>
#include <iostream>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "client/cli/cli.h"
#include "client/convert_hdf5/hdf5_arguments.h"
#include "client/convert_step/step_arguments.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/base/version.h"
#include "core/command_line/completion.h"
#include "core/command_line/help.h"
#include "core/command_line/man_page.h"
#include "server/program/health_check_arguments.h"
#include "server/program/options.h"

namespace evpose {
namespace {

// Sections of the manual.
constexpr int kUserCommands = 1;
constexpr int kAdministration = 8;

// `evpose server` has no page: its name would be evpose-server, and man would display it instead of the page of the
// program evpose-server.
bool HasPage(const CLI::App& command) { return command.get_parent() == nullptr || command.get_name() != "server"; }

std::string Reference(const CLI::App& command, int section) {
  const int in = HasPage(command) ? section : kAdministration;
  return absl::StrCat(ManPageName(DescribeCommand(command)), "(", in, ")");
}

// The pages of the command above and of those below.
std::vector<std::string> Neighbours(const CLI::App& command, int section) {
  std::vector<std::string> pages;
  if (command.get_parent() != nullptr) pages.push_back(Reference(*command.get_parent(), section));
  for (const CLI::App* const below : command.get_subcommands([](const CLI::App*) { return true; })) {
    pages.push_back(Reference(*below, section));
  }
  return pages;
}

absl::Status WriteProgram(const CLI::App& program, int section, const std::string& other,
                          const std::filesystem::path& directory) {
  const std::filesystem::path pages = directory / absl::StrCat("man", section);
  std::filesystem::create_directories(pages);
  for (const CLI::App* const command : AllCommands(program)) {
    if (!HasPage(*command)) continue;
    const HelpPage page = DescribeCommand(*command);
    std::vector<std::string> see_also = Neighbours(*command, section);
    if (command == &program && std::find(see_also.begin(), see_also.end(), other) == see_also.end()) {
      see_also.push_back(other);
    }
    EVPOSE_RETURN_IF_ERROR(WriteFile((pages / absl::StrCat(ManPageName(page), ".", section)).string(),
                                     FormatManPage(page, section, ThisBuild().version, see_also)));
  }
  EVPOSE_RETURN_IF_ERROR(WriteFile((directory / "bash" / program.get_name()).string(), BashCompletion(program)));
  return WriteFile((directory / "zsh" / absl::StrCat("_", program.get_name())).string(), ZshCompletion(program));
}

absl::Status WriteAll(const std::filesystem::path& directory) {
  for (const char* const part : {"bash", "zsh"}) std::filesystem::create_directories(directory / part);
  client::CliContext context{std::cout, std::cerr};
  client::CommandRunners runners;
  EVPOSE_RETURN_IF_ERROR(
      WriteProgram(*client::MakeParser(context, runners), kUserCommands, "evpose-server(8)", directory));
  client::StepArguments step;
  EVPOSE_RETURN_IF_ERROR(WriteProgram(*client::MakeStepParser(step), kUserCommands, "evpose(1)", directory));
  client::Hdf5Arguments hdf5;
  EVPOSE_RETURN_IF_ERROR(WriteProgram(*client::MakeHdf5Parser(hdf5), kUserCommands, "evpose(1)", directory));
  server::HealthCheckArguments health_check;
  EVPOSE_RETURN_IF_ERROR(
      WriteProgram(*server::MakeHealthCheckParser(health_check), kAdministration, "evpose-server(8)", directory));
  absl::Status status;
  server::UseParser(
      [&](const CLI::App& program) { status = WriteProgram(program, kAdministration, "evpose(1)", directory); });
  return status;
}

absl::StatusOr<int> Run(const std::vector<std::string>& arguments) {
  if (arguments.size() != 1) {
    std::cerr << "usage: evpose-help-files DIRECTORY\n";
    return 2;
  }
  EVPOSE_RETURN_IF_ERROR(WriteAll(arguments.front()));
  return 0;
}

}  // namespace
}  // namespace evpose

int main(int argc, char** argv) {
  return evpose::RunProgram("evpose-help-files",
                            [&] { return evpose::Run(std::vector<std::string>(argv + 1, argv + argc)); });
}
