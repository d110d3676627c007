// SPDX-License-Identifier: Apache-2.0

// `evpose`: the command line as a function, so that tests can run it without a process.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "client/cli/common/command.h"
#include "client/cli/console/cli_context.h"

namespace evpose::client {

// Runs the command that `arguments` name (without the program's name). Returns the exit status: 0 for success; 1 for a
// failure, with its cause and remedy in one line on `context.err`; 2 for wrong usage.
int RunCli(const std::vector<std::string>& arguments, CliContext& context);

// The parser with all commands and their help; `runners` run them. The context must outlive both.
std::unique_ptr<CLI::App> MakeParser(CliContext& context, CommandRunners& runners);

}  // namespace evpose::client
