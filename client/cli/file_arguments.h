// SPDX-License-Identifier: Apache-2.0

// The files that the options of a command name.
#pragma once

#include <CLI/CLI.hpp>

#include "absl/status/status.h"

namespace evpose::client {

// Checks a command whose arguments have been parsed: returns a usage error if an option of an output file
// (AddOutputFile()) names a file that another option names, too. The values of all other options whose type contains
// FILE are inputs, and so are the files in the directories of options of inputs, except for earlier results.
absl::Status CheckFileArguments(CLI::App& command);

}  // namespace evpose::client
