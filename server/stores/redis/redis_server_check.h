// SPDX-License-Identifier: Apache-2.0

// Whether a Redis server can have a store.
#pragma once

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "server/stores/redis/redis_client.h"

namespace evpose::server {

// Checks that the server, which errors call `server`, responds, its version and its eviction policy, and that it does
// not have sessions in the layout without buckets. Errors: those of RedisClient; FAILED_PRECONDITION.
absl::Status CheckRedisServer(RedisClient& client, absl::string_view server);

}  // namespace evpose::server
