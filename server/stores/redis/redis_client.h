// SPDX-License-Identifier: Apache-2.0

// The one thread that talks to Redis for a store.
#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/functional/any_invocable.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/stores/common/job_thread.h"
#include "server/stores/redis/redis_address.h"
#include "server/stores/redis/redis_connection.h"
#include "server/stores/redis/redis_scripts.h"

namespace evpose::server {

struct RedisClientOptions {
  RedisAddress address;
  // Of every single wait: for a connection, and for bytes of an answer.
  absl::Duration timeout = absl::Seconds(5);
  // After a failure no new connection is tried for so long, doubled up to the longest: what is asked for meanwhile
  // fails at once.
  absl::Duration first_backoff = absl::Milliseconds(50);
  absl::Duration longest_backoff = absl::Seconds(2);
};

// What waits is sent together, and the answers read after it. Thread-safe. Outlives its store, closed.
class RedisClient {
 public:
  // With the answer, or: UNAVAILABLE; CANCELLED closed; RESOURCE_EXHAUSTED the server's memory is full, though no ended
  // session is left to delete; what RedisConnection says.
  using Done = absl::AnyInvocable<void(absl::StatusOr<RedisReply>)>;

  explicit RedisClient(const RedisClientOptions& options);

  // `done` is called once, on the thread; within Push when it is closed.
  void Push(RedisCommand command, Done done);
  void PushScript(const RedisScript& script, const std::vector<std::string>& keys, std::vector<std::string> arguments,
                  Done done);
  // Wait; not from the thread.
  absl::StatusOr<RedisReply> Call(RedisCommand command);
  absl::StatusOr<RedisReply> CallScript(const RedisScript& script, const std::vector<std::string>& keys,
                                        std::vector<std::string> arguments);

  // What waits is still tried, each wait bounded. Once.
  void Close();

  // The names of sessions that had to go for room, since the last call.
  std::vector<std::string> TakeDeletedForRoom();

 private:
  struct Job {
    const RedisScript* script = nullptr;  // the command's second word is to be its digest
    RedisCommand command;
    Done done;
  };

  void Process(std::vector<Job> jobs);
  absl::Status Connect();
  void Disconnect();
  absl::StatusOr<RedisReply> RunAgain(const Job& job, absl::StatusOr<RedisReply> reply);
  bool DeleteOldestEnded();

  const RedisClientOptions options_;
  // Of the thread.
  std::unique_ptr<RedisConnection> connection_;
  std::map<const RedisScript*, std::string> digests_;  // that this connection's server has given
  absl::Duration backoff_;
  std::chrono::steady_clock::time_point next_connection_;

  std::mutex mutex_;
  std::vector<std::string> deleted_for_room_ ABSL_GUARDED_BY(mutex_);
  JobThread<Job> thread_;  // last: it uses what stands above
};

}  // namespace evpose::server
