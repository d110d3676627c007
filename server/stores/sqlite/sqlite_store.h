// SPDX-License-Identifier: Apache-2.0

// One file in a directory of the server's own: what was committed survives the process and the machine's power.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/stores/common/store.h"

namespace evpose::server {

struct SqliteStoreOptions {
  std::string data_dir;              // made, for its owner only, when the directory above it is there
  uint64_t max_bytes = 64ull << 30;  // of the file; its log has up to 128 MB beside it
};

// Reads all that is there, and says in damage() what is left out of it. Errors: those of DataDirectory and of
// OpenSqliteFile(), in words for who starts the server.
absl::StatusOr<std::unique_ptr<Store>> OpenSqliteStore(const SqliteStoreOptions& options);

}  // namespace evpose::server
