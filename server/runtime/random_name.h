// SPDX-License-Identifier: Apache-2.0

// Names that cannot be guessed: sessions and their tokens.
#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace evpose::server {

// 32 hex digits from the system's random source. Errors: INTERNAL when it fails.
absl::StatusOr<std::string> RandomHex128();

// Compares without telling by its duration where they differ.
bool SecretsEqual(absl::string_view a, absl::string_view b);

}  // namespace evpose::server
