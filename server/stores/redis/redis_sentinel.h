// SPDX-License-Identifier: Apache-2.0

// Finds the master of a group of Redis servers through its Sentinels, which exchange a master that has failed.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/stores/redis/redis_address.h"
#include "server/stores/redis/redis_connection.h"

namespace evpose::server {

struct RedisSentinelOptions {
  // The limit of each wait for a Sentinel, and for the node that it names. Short, because the machine of a Sentinel or
  // of the master may be gone and then does not even refuse the connection.
  absl::Duration timeout = absl::Seconds(1);
  // How long a call waits while the Sentinels name a node that is not a master, or has no replica: they need some
  // seconds to replace a master. After a call has waited without a result, the next ones do not wait.
  absl::Duration failover_wait = absl::Seconds(5);
  // The delay before the Sentinels are asked again while a call waits.
  absl::Duration pause = absl::Milliseconds(50);
};

// Finds the master through Sentinels; for one thread, in which SIGPIPE is blocked.
class RedisSentinels {
 public:
  // `address` has Sentinels. Its user, password and database are those of the Redis servers; a Sentinel receives user
  // and password only if it requires them.
  RedisSentinels(const RedisAddress& address, const RedisSentinelOptions& options);

  // Asks the Sentinels in turn for the master, connects to it, and confirms by ROLE that it is one; the waits on the
  // connection are bounded by `reply_timeout`. Asks again while the node that they name is not a master, until
  // `gives_up` is true. Errors: PERMISSION_DENIED when the node rejects user or password.
  // UNAVAILABLE: no Sentinel responds (with the reason of each), none knows the master's name, or the node that they
  // name does not respond or is not a master.
  absl::StatusOr<std::unique_ptr<RedisConnection>> ConnectToMaster(absl::Duration reply_timeout,
                                                                   const std::function<bool()>& gives_up);

  absl::Duration pause() const { return options_.pause; }
  // The next query begins with the next Sentinel: the one that was asked may be cut off, together with a master that
  // was replaced.
  void StartWithNextSentinel() { first_ = (first_ + 1) % address_.sentinels.size(); }

 private:
  struct Named {
    RedisHost sentinel;
    RedisHost node;
  };
  // Returns the first reply of a Sentinel, beginning with `first_`.
  absl::StatusOr<Named> AskAll();
  // Returns the node, or a node without a host if the Sentinel does not know the master's name.
  absl::StatusOr<RedisHost> Ask(const RedisHost& sentinel) const;
  absl::StatusOr<std::unique_ptr<RedisConnection>> ConnectTo(const Named& named) const;

  const RedisAddress address_;
  const RedisSentinelOptions options_;
  size_t first_ = 0;
};

}  // namespace evpose::server
