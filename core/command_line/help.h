// SPDX-License-Identifier: Apache-2.0

// The --help of all programs of the project that parse their arguments with CLI11.
#pragma once

#include <CLI/CLI.hpp>
#include <cstddef>
#include <string>

#include "core/command_line/help_page.h"

namespace evpose {

// The text of --help, with lines of at most `width` characters.
std::string FormatHelp(const HelpPage& page, size_t width);

// The columns of the terminal that is open as `descriptor`; 80 if there is none.
size_t TerminalColumns(int descriptor);

// The columns of a text for a person: the variable COLUMNS, otherwise those of the terminal; between 40 and 100,
// because longer lines are hard to read.
size_t TextWidth(int descriptor);

// Gives a parser and all of its commands this help, for the terminal on standard output. To be called when all commands
// have been added.
void UseHelp(CLI::App& program);

// The error of a parser in one line, after the name of its command: "evpose replay: The following argument was not
// expected: --modle; did you mean --model? evpose replay --help lists the options".
std::string UsageMessage(const CLI::App& command, const CLI::Error& error);

// "evpose replay --help lists the options": the end of every error of usage.
std::string HelpHint(const CLI::App& command);

}  // namespace evpose
