// SPDX-License-Identifier: Apache-2.0

// The --help of all programs of the project that parse their arguments with CLI11.
#pragma once

#include <CLI/CLI.hpp>
#include <cstddef>
#include <optional>
#include <string>

#include "absl/functional/function_ref.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
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

// Parses the arguments of a program. Returns the exit status with which the program has to end: 0 after it has printed
// the help or the version, 2 after an error of usage, which it has printed on standard error; nullopt if it has to run.
std::optional<int> ParseOrAnswer(CLI::App& program, int argc, const char* const* argv);

// Runs `run` as the main function of a program, and returns its exit status. If it returns an error or throws, prints
// "NAME: cause" on standard error and returns 1.
int RunProgram(absl::string_view name, absl::FunctionRef<absl::StatusOr<int>()> run);

}  // namespace evpose
