// SPDX-License-Identifier: Apache-2.0

// A store in one SQLite file in the data directory of a server. Commits survive a crash of the process and a power
// loss.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/stores/common/store.h"

namespace evpose::server {

struct SqliteStoreOptions {
  std::string data_dir;              // created for its owner only; the parent directory must exist
  uint64_t max_bytes = 64ull << 30;  // of the file and the log beside it
  // Size of the largest file that is read completely at the start, bytes: about half a second.
  uint64_t max_checked_bytes = 64ull << 20;
};

// Opens the store, and checks all records of a file that is not too large, or in which damage has been read; damage()
// lists those that are skipped. Errors: those of DataDirectory::Open() and OpenSqliteFile(), written for the operator
// of the server.
absl::StatusOr<std::unique_ptr<Store>> OpenSqliteStore(const SqliteStoreOptions& options);

}  // namespace evpose::server
