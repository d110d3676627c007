// SPDX-License-Identifier: Apache-2.0

// Which store: the server's options in one place.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/stores/common/store.h"

namespace evpose::server {

struct StoreOptions {
  // "memory": nothing outlives the process. "sqlite": one file in `data_dir`. Or where a Redis server is, as
  // ParseRedisAddress() has it.
  std::string store = "memory";
  std::string data_dir;              // of "sqlite"
  uint64_t max_bytes = 64ull << 30;  // of sessions in memory, or of the file; Redis has its own limit
};

// Errors: INVALID_ARGUMENT for a store of no kind there is; those of OpenSqliteStore(),
// ParseRedisAddress() and OpenRedisStore(). None shows a password.
absl::StatusOr<std::unique_ptr<Store>> OpenStore(const StoreOptions& options);

}  // namespace evpose::server
