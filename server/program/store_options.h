// SPDX-License-Identifier: Apache-2.0

// The options of the store, beside their definition (options.cc).
#pragma once

#include <string>

#include "absl/status/status.h"
#include "server/program/options.h"

namespace evpose::server {

// Checks --store without opening the store. The error never contains a possible password.
absl::Status CheckStore(const std::string& store);
// Checks that --store-password-file and --store are consistent.
absl::Status CheckStorePassword(const ProgramOptions& options);
absl::Status CheckStoreLimit(const StoreOptions& store);
// Checks that --divide-store and --store are consistent.
absl::Status CheckDivideStore(const ProgramOptions& options);

}  // namespace evpose::server
