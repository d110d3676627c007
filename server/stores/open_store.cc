// SPDX-License-Identifier: Apache-2.0
#include "server/stores/open_store.h"

#include <cstring>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/stores/memory/memory_store.h"
#include "server/stores/postgres/postgres_store.h"
#include "server/stores/redis/redis_groups_file.h"
#include "server/stores/redis/redis_store.h"
#include "server/stores/sqlite/sqlite_store.h"

namespace evpose::server {
namespace {

absl::StatusOr<std::vector<RedisGroupOptions>> GroupsOf(const StoreOptions& options) {
  EVPOSE_ASSIGN_OR_RETURN(
      auto addresses, ReadRedisGroups(options.store.substr(std::strlen(kRedisGroupsPrefix)), options.groups_password));
  std::vector<RedisGroupOptions> groups;
  for (RedisGroupAddress& group : addresses) {
    groups.push_back({.name = std::move(group.name), .client = {.address = std::move(group.address)}});
  }
  return groups;
}

}  // namespace

absl::StatusOr<StoreKind> KindOfStore(absl::string_view store) {
  if (store == "memory") return StoreKind::kMemory;
  if (store == "sqlite") return StoreKind::kSqlite;
  if (IsPostgresUrl(store)) return StoreKind::kPostgresql;
  if (HasRedisGroups(store) || absl::StrContains(store, "://")) return StoreKind::kRedis;
  return absl::InvalidArgumentError(
      absl::StrCat("there is no store ", absl::StrContains(store, '@') ? "of this name" : store,
                   ": give memory, sqlite, redis://HOST:PORT, redis+sentinel://HOST:PORT,.../NAME, "
                   "redis-groups:FILE or postgresql://HOST:PORT/DATABASE"));
}

bool HasRedisGroups(absl::string_view store) { return absl::StartsWith(store, kRedisGroupsPrefix); }

absl::StatusOr<std::unique_ptr<Store>> OpenStore(const StoreOptions& options) {
  EVPOSE_ASSIGN_OR_RETURN(const StoreKind kind, KindOfStore(options.store));
  switch (kind) {
    case StoreKind::kMemory:
      return MakeMemoryStore(options.max_bytes);
    case StoreKind::kSqlite:
      return OpenSqliteStore({.data_dir = options.data_dir, .max_bytes = options.max_bytes});
    case StoreKind::kPostgresql: {
      PostgresStoreOptions postgres;
      EVPOSE_ASSIGN_OR_RETURN(postgres.client.address, ParsePostgresAddress(options.store));
      postgres.client.max_bytes = options.max_bytes;
      return OpenPostgresStore(postgres);
    }
    case StoreKind::kRedis:
      break;
  }
  RedisStoreOptions redis;
  if (HasRedisGroups(options.store)) {
    EVPOSE_ASSIGN_OR_RETURN(redis.groups, GroupsOf(options));
  } else {
    EVPOSE_ASSIGN_OR_RETURN(redis.client.address, ParseRedisAddress(options.store));
  }
  return OpenRedisStore(redis);
}

absl::Status DivideStore(const StoreOptions& options, const std::function<void(const std::string&)>& print) {
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<RedisGroupOptions> group_options, GroupsOf(options));
  RedisGroups groups(group_options);
  int num_moves = 0;
  absl::Status status = groups.Open();
  if (status.ok()) {
    status = groups.Divide([&](const RedisGroups::Move& move) {
      ++num_moves;
      print(absl::StrCat("bucket ", move.bucket, " moved from ", move.from, " to ", move.to));
    });
  }
  std::string parts;
  for (const StoreGroup& group : groups.groups()) absl::StrAppend(&parts, ", ", group.name, " has ", group.parts);
  groups.Close();
  if (status.ok()) print(absl::StrCat(num_moves, " buckets moved", parts));
  return status;
}

}  // namespace evpose::server
