// SPDX-License-Identifier: Apache-2.0

// Opens the store that the server's options name.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/stores/common/store.h"

namespace evpose::server {

struct StoreOptions {
  // "memory": nothing outlives the process. "sqlite": one file in `data_dir`. Otherwise the address of a Redis server,
  // or of the Sentinels that name it, in the form of ParseRedisAddress(); or of a PostgreSQL database, in the form of
  // ParsePostgresAddress().
  std::string store = "memory";
  std::string data_dir;  // used by "sqlite"
  uint64_t max_bytes =
      64ull << 30;  // size of sessions in memory or PostgreSQL, or of the SQLite file; Redis has its own
};

// Errors: INVALID_ARGUMENT for an unknown kind of store; those of OpenSqliteStore(), ParseRedisAddress(),
// OpenRedisStore(), ParsePostgresAddress() and OpenPostgresStore(). No error contains a password.
absl::StatusOr<std::unique_ptr<Store>> OpenStore(const StoreOptions& options);

}  // namespace evpose::server
