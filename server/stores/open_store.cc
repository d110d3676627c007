// SPDX-License-Identifier: Apache-2.0
#include "server/stores/open_store.h"

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/stores/memory/memory_store.h"
#include "server/stores/postgres/postgres_store.h"
#include "server/stores/redis/redis_store.h"
#include "server/stores/sqlite/sqlite_store.h"

namespace evpose::server {

absl::StatusOr<std::unique_ptr<Store>> OpenStore(const StoreOptions& options) {
  if (options.store == "memory") return MakeMemoryStore(options.max_bytes);
  if (options.store == "sqlite") {
    return OpenSqliteStore({.data_dir = options.data_dir, .max_bytes = options.max_bytes});
  }
  if (IsPostgresUrl(options.store)) {
    PostgresStoreOptions postgres;
    EVPOSE_ASSIGN_OR_RETURN(postgres.client.address, ParsePostgresAddress(options.store));
    postgres.client.max_bytes = options.max_bytes;
    return OpenPostgresStore(postgres);
  }
  if (absl::StrContains(options.store, "://")) {
    RedisStoreOptions redis;
    EVPOSE_ASSIGN_OR_RETURN(redis.client.address, ParseRedisAddress(options.store));
    return OpenRedisStore(redis);
  }
  return absl::InvalidArgumentError(
      absl::StrCat("there is no store \"", options.store,
                   "\": give memory, sqlite, redis://HOST:PORT, redis+sentinel://HOST:PORT,.../NAME or "
                   "postgresql://HOST:PORT/DATABASE"));
}

}  // namespace evpose::server
