// SPDX-License-Identifier: Apache-2.0

// Opens the store that the server's options name.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/stores/common/store.h"

namespace evpose::server {

struct StoreOptions {
  // "memory": nothing outlives the process. "sqlite": one file in `data_dir`. Otherwise the address of a Redis server,
  // or of the Sentinels that name it, in the form of ParseRedisAddress(); or of a PostgreSQL database, in the form of
  // ParsePostgresAddress(). "redis-groups:FILE": several Redis groups, which the file names (ParseRedisGroups()).
  std::string store = "memory";
  std::string groups_password;  // of the addresses in that file that have none
  std::string data_dir;         // used by "sqlite"
  uint64_t max_bytes =
      64ull << 30;  // size of sessions in memory or PostgreSQL, or of the SQLite file; Redis has its own
};

// The kind of a store, from StoreOptions::store. The address is not parsed. Error: INVALID_ARGUMENT, which never
// contains a possible password.
absl::StatusOr<StoreKind> KindOfStore(absl::string_view store);
// Whether a store in Redis is "redis-groups:FILE".
bool HasRedisGroups(absl::string_view store);

// Errors: those of KindOfStore(), OpenSqliteStore(), ParseRedisAddress(),
// ReadRedisGroups(), OpenRedisStore(), ParsePostgresAddress() and OpenPostgresStore(). No error contains a password.
absl::StatusOr<std::unique_ptr<Store>> OpenStore(const StoreOptions& options);

// Moves sessions and models until all groups of "redis-groups:FILE" have equal parts of the store, while servers use it
// (RedisGroups::Divide()). Calls `print` with a line for each move, and one at the end. Errors: those of
// ReadRedisGroups(), RedisGroups::Open() and RedisGroups::Divide().
absl::Status DivideStore(const StoreOptions& options, const std::function<void(const std::string&)>& print);

}  // namespace evpose::server
