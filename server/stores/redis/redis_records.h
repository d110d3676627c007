// SPDX-License-Identifier: Apache-2.0

// The records of sessions in replies of Redis. Errors of all functions: DATA_LOSS naming the damaged part.
#pragma once

#include <hiredis/hiredis.h>

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/stores/common/store.h"

namespace evpose::server {

struct RedisSession {
  StoredSession stored;
  uint64_t fencing_number = 0;
  uint64_t next_pose_seq = 1;
};

// Parses the reply of kRedisRead. Errors: NOT_FOUND.
absl::StatusOr<RedisSession> ParseRedisSession(absl::string_view name, uint64_t after_pose_seq,
                                               const redisReply* reply);
// `encoded`: the field `lifecycle` of a session.
absl::StatusOr<StoredLifecycle> DecodeStoredLifecycle(absl::string_view name, std::string encoded);

}  // namespace evpose::server
