// SPDX-License-Identifier: Apache-2.0

// A C++ interface to hiredis with owned values and absl::Status.
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

// Returns the bytes of a string, status or error reply; empty for every other type.
std::string RedisText(const redisReply* reply);
// The same for an element of a list; empty if the list is shorter.
std::string RedisTextAt(const redisReply* list, size_t i);
std::vector<std::string> RedisTexts(const redisReply* list);

// One connection. After an error of the connection itself (broken()) it cannot be used any more. For one thread, in
// which SIGPIPE is blocked.
class RedisConnection {
 public:
  // Connects, authenticates and selects the database. `timeout` bounds each wait, here and later. Errors: UNAVAILABLE;
  // PERMISSION_DENIED for a wrong password.
  static absl::StatusOr<std::unique_ptr<RedisConnection>> Open(const RedisAddress& address, absl::Duration timeout);
  // Does the same as Open(), but neither authenticates nor selects a database. `name` is the server's name in errors.
  static absl::StatusOr<std::unique_ptr<RedisConnection>> Connect(const RedisAddress& address, std::string name,
                                                                  absl::Duration timeout);
  // Sends the user and password of `address`, if there are any.
  absl::Status Authenticate(const RedisAddress& address);
  // Changes the limit of each wait.
  void SetTimeout(absl::Duration timeout);

  // Sends the commands and reads one reply for each, in order. An error reply is returned as a status. When a reply
  // does not arrive, it and all later ones are UNAVAILABLE, and broken() is true.
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

// True if Redis has not executed a command because it is a replica, or a master without replicas.
bool IsRedisRefusal(const absl::Status& status);

// The error of a script for a bucket that is in another group. `state` is the state of the bucket in this group.
absl::Status RedisElsewhereError(absl::string_view state);
bool IsRedisElsewhere(const absl::Status& status);

// True if Redis no longer has the script in its cache, so that its source must be sent again.
bool IsRedisScriptMissing(const absl::Status& status);

}  // namespace evpose::server
