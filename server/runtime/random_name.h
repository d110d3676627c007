// SPDX-License-Identifier: Apache-2.0

// Names that cannot be guessed, for sessions and their resume tokens.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace evpose::server {

// 32 hex digits from the system's random source. Errors: INTERNAL when it fails.
absl::StatusOr<std::string> RandomHex128();

// Compares in constant time, so that the duration does not reveal the first difference. False for different lengths.
bool SecretsEqual(absl::string_view a, absl::string_view b);

}  // namespace evpose::server
