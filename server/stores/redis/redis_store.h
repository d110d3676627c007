// SPDX-License-Identifier: Apache-2.0

// Sessions in Redis: any of several servers can take one up.
#pragma once

#include <cstdint>
#include <memory>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/stores/common/store.h"
#include "server/stores/redis/redis_client.h"

namespace evpose::server {

struct RedisStoreOptions {
  RedisClientOptions client;
  // A session that no server has written nor taken for so long goes, whatever became of the servers.
  absl::Duration safety_ttl = absl::Hours(24 * 30);
  // Of one session: beyond, the oldest go. Bounds the stream when nobody says what is to be forgotten.
  uint64_t max_segments = 65536;
};

// As durable as Redis is set up to be: with `appendonly yes` and `appendfsync always` like a file, else a crash of
// Redis may lose the last second. Models and the records of sessions are read at opening; the rest of a session is
// checked when it is read. Errors: UNAVAILABLE; PERMISSION_DENIED; FAILED_PRECONDITION for a Redis before 6.2, and for
// one that would forget what it has when its memory is full.
absl::StatusOr<std::unique_ptr<Store>> OpenRedisStore(const RedisStoreOptions& options);

}  // namespace evpose::server
