// SPDX-License-Identifier: Apache-2.0

// STEP and IGES files, converted by evpose-convert-step (client/convert_step).
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace evpose::client {

struct ConvertedModel {
  std::string mesh;                  // a serialized Mesh
  std::vector<std::string> notices;  // what is missing, and what was repaired
};

// Errors: FAILED_PRECONDITION, naming the package, if evpose-convert-step is not installed; those of RunConverter().
absl::StatusOr<ConvertedModel> ConvertStep(const std::string& path);

// Runs `program`, which prints a serialized Mesh of the file `path`, and notices as lines of standard error that begin
// with "notice: ". Errors: INVALID_ARGUMENT with the last line that the program has written to standard error, if it
// ends with another status than 0; INTERNAL if it cannot be started or crashes.
absl::StatusOr<ConvertedModel> RunConverter(const std::string& program, const std::string& path);

}  // namespace evpose::client
