// SPDX-License-Identifier: Apache-2.0

// STEP and IGES files, converted by evpose-convert-step (client/convert_step).
#pragma once

#include <string>

#include "absl/status/statusor.h"

namespace evpose::client {

// Returns the file as a serialized Mesh. Errors: FAILED_PRECONDITION, naming the package, if evpose-convert-step is not
// installed; those of RunConverter().
absl::StatusOr<std::string> ConvertStep(const std::string& path);

// Runs `program`, which prints a serialized Mesh of the file `path`. Errors: INVALID_ARGUMENT with the last line that
// the program has written to standard error, if it ends with another status than 0; INTERNAL if it cannot be started or
// crashes.
absl::StatusOr<std::string> RunConverter(const std::string& program, const std::string& path);

}  // namespace evpose::client
