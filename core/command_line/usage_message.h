// SPDX-License-Identifier: Apache-2.0

// The errors of usage of all programs of the project: what is wrong with the arguments, and what to do.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace evpose {

// The error of a parser in one line, in the words of the project, after the name of its command: "evpose replay: there
// is no option --modle; did you mean --model? evpose replay --help lists the options". A value of an environment
// variable is reported with the name of the variable.
std::string UsageMessage(const CLI::App& command, const CLI::Error& error);

// "evpose replay --help lists the options": the end of every error of usage.
std::string HelpHint(const CLI::App& command);

}  // namespace evpose
