// SPDX-License-Identifier: Apache-2.0

// hiredis as values and statuses.
#pragma once

#include <hiredis/hiredis.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/stores/redis/redis_address.h"

namespace evpose::server {

struct RedisReplyDeleter {
  void operator()(redisReply* reply) const { freeReplyObject(reply); }
};
using RedisReply = std::unique_ptr<redisReply, RedisReplyDeleter>;

using RedisCommand = std::vector<std::string>;

// The bytes of a string, a status or an error; empty for everything else.
std::string RedisText(const redisReply* reply);

// One connection, which is never used again after an error of its own. For one thread, in which SIGPIPE is blocked.
class RedisConnection {
 public:
  // Logs in and chooses the database. `timeout` bounds this and every wait later. Errors: UNAVAILABLE;
  // PERMISSION_DENIED for a wrong password.
  static absl::StatusOr<std::unique_ptr<RedisConnection>> Open(const RedisAddress& address, absl::Duration timeout);

  // Sends commands and reads an answer for each, in order; what the server answers with an error is that, as a status.
  // After an answer that does not come, the rest is UNAVAILABLE, and broken() true.
  std::vector<absl::StatusOr<RedisReply>> Run(const std::vector<RedisCommand>& commands);
  absl::StatusOr<RedisReply> Run(const RedisCommand& command);
  bool broken() const { return context_->err != 0; }

 private:
  struct ContextDeleter {
    void operator()(redisContext* context) const { redisFree(context); }
  };
  RedisConnection(std::string name, redisContext* context) : name_(std::move(name)), context_(context) {}
  absl::StatusOr<RedisReply> Read();
  absl::Status Broken() const;

  const std::string name_;  // for errors
  const std::unique_ptr<redisContext, ContextDeleter> context_;
};

// The server has forgotten the script: to be sent whole.
bool IsRedisScriptMissing(const absl::Status& status);

}  // namespace evpose::server
