// SPDX-License-Identifier: Apache-2.0

// The files that the options of a command name.
#pragma once

#include <CLI/CLI.hpp>

#include "absl/status/status.h"

namespace evpose::client {

// Returns a usage error if an output file of a parsed command is also an input or another output of it. Options that
// were added by AddOutputFile() name outputs. Inputs are the values of the other options whose type contains FILE, and
// the files in the directories that options of inputs name, except for results of earlier runs.
absl::Status CheckFileArguments(CLI::App& command);

}  // namespace evpose::client
