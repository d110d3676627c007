// SPDX-License-Identifier: Apache-2.0

// Runs the program gnuplot.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace evpose::client {

// What gnuplot, found along PATH and run without its start-up files, writes to standard output on the commands in
// `script`. No shell is involved. Errors: FAILED_PRECONDITION when the program is missing, saying what to install;
// INTERNAL with its message when it fails.
absl::StatusOr<std::string> RunGnuplot(const std::string& script);

// The text in quotes within which gnuplot replaces nothing; control characters become spaces.
std::string GnuplotQuoted(const std::string& text);

}  // namespace evpose::client
