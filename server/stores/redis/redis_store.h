// SPDX-License-Identifier: Apache-2.0

// A store in Redis, which several servers share: each of them can acquire any session.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/stores/common/store.h"
#include "server/stores/redis/redis_groups.h"

namespace evpose::server {

struct RedisStoreOptions {
  RedisClientOptions client;  // of the only group
  // Several groups, among which the sessions are divided. Empty: one, that of `client`.
  std::vector<RedisGroupOptions> groups;
  // Redis deletes a session that no server has written or acquired for this time, so that nothing is left behind when
  // all servers are gone.
  absl::Duration safety_ttl = absl::Hours(24 * 30);
  // The maximum number of pose segments of a session; the oldest are deleted beyond it. Bounds the stream when commits
  // do not raise first_pose_seq_kept.
  uint64_t max_segments = 65536;
  // Largest number of sessions and models that are read completely at the start: some tenths of a second.
  size_t max_checked_records = 256;
};

// Opens the store and reads all models and sessions once, unless there are too many, to find damaged ones. The store is
// as durable as Redis is configured to be: with `appendonly yes` and `appendfsync always` like a file; otherwise a
// crash of Redis may lose the last second. With Sentinels, writes that this store acknowledges are at a replica, too.
// Errors: those of RedisGroups::Open().
absl::StatusOr<std::unique_ptr<Store>> OpenRedisStore(const RedisStoreOptions& options);

}  // namespace evpose::server
