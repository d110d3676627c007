// SPDX-License-Identifier: Apache-2.0

// Completion of command lines in bash and zsh, from the parser of a program.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace evpose {

// A script that bash sources, typically from /usr/share/bash-completion/completions/PROGRAM. It completes commands,
// options, their values, and the names of files and directories.
std::string BashCompletion(const CLI::App& program);

// The same for zsh, as the file _PROGRAM in a directory of $fpath; it also displays the descriptions.
std::string ZshCompletion(const CLI::App& program);

}  // namespace evpose
