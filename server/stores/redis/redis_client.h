// SPDX-License-Identifier: Apache-2.0

// The client of a store: one thread with one connection to Redis.
#pragma once

#include <atomic>
#include <chrono>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
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
#include "server/stores/redis/redis_sentinel.h"

namespace evpose::server {

struct RedisClientOptions {
  RedisAddress address;
  // The limit of each wait: for a connection, and for the next bytes of a reply.
  absl::Duration timeout = absl::Seconds(5);
  // After a failure no new connection is tried for this time, doubled for each further failure up to `longest_backoff`.
  // Commands in the meantime fail immediately. A short interruption costs little with the first; with the last a server
  // that returns is noticed after one second.
  absl::Duration first_backoff = absl::Milliseconds(50);
  absl::Duration longest_backoff = absl::Seconds(1);
  // Used if the address has Sentinels.
  RedisSentinelOptions sentinel;
  // The limit of each wait for a replica's acknowledgement, which takes one round trip while the replica keeps up; one
  // more wait for each 10 MB of a large command. Shorter than `timeout`, after which the connection is given up.
  absl::Duration replica_timeout = absl::Seconds(1);
};

// The servers that must have the effect of a command, and of all earlier ones, before it is successful. With Sentinels
// a write that is acknowledged to a client needs kReplica, because a failover loses what only the master has. A single
// Redis server has no replica; then kReplica is the same as kMaster.
enum class Acknowledgement { kMaster, kReplica };

// Sends all waiting commands together and then reads the replies (pipelining). Thread-safe. Leases may hold the client
// after its store has closed it.
class RedisClient {
 public:
  // Receives the reply or an error. UNAVAILABLE: also when no replica acknowledges the command in time; the command may
  // then be written all the same. CANCELLED: the client is closed. RESOURCE_EXHAUSTED: the memory of Redis is full and
  // no ended session is left to delete. Others: those of RedisConnection.
  using Done = absl::AnyInvocable<void(absl::StatusOr<RedisReply>)>;

  struct Command {
    RedisCommand words;                   // the arguments, if there is a script
    const RedisScript* script = nullptr;  // null: a command
    std::vector<std::string> keys;        // of the script
    Acknowledgement acknowledgement = Acknowledgement::kMaster;
  };

  explicit RedisClient(const RedisClientOptions& options);

  // Queues a command. `done` is called once, on the client's thread; within Push() when the client is closed.
  void Push(RedisCommand command, Done done) { Push(std::move(command), Acknowledgement::kMaster, std::move(done)); }
  void Push(RedisCommand command, Acknowledgement acknowledgement, Done done);
  void Push(Command command, Done done);
  // Does the same as Push(), and waits for the reply. Not to be called from the client's thread.
  absl::StatusOr<RedisReply> Call(RedisCommand command, Acknowledgement acknowledgement = Acknowledgement::kMaster);
  // These do the same as Call() and CallScript() without waiting: calls that are started one after the other are sent
  // together.
  std::future<absl::StatusOr<RedisReply>> Start(RedisCommand command,
                                                Acknowledgement acknowledgement = Acknowledgement::kMaster);
  std::future<absl::StatusOr<RedisReply>> StartScript(const RedisScript& script, const std::vector<std::string>& keys,
                                                      std::vector<std::string> arguments,
                                                      Acknowledgement acknowledgement);
  absl::StatusOr<RedisReply> CallScript(const RedisScript& script, const std::vector<std::string>& keys,
                                        std::vector<std::string> arguments,
                                        Acknowledgement acknowledgement = Acknowledgement::kMaster);

  // Starts all commands, as Start() and StartScript() do for one. The client's thread gets them at once, so that they
  // need few round trips also on a busy machine.
  std::vector<std::future<absl::StatusOr<RedisReply>>> StartAll(std::vector<Command> commands);

  // Processes the waiting commands, each with the bounded wait, and closes the connection. To be called once.
  void Close();

  // Scripts that had run and that no replica acknowledged in time; 0 without Sentinels. Thread-safe.
  uint64_t unreplicated_commits() const { return unreplicated_commits_; }

  // Returns the names of the sessions that were deleted since the last call because the memory of Redis was full.
  std::vector<std::string> TakeDeletedForRoom();

 private:
  struct Job {
    const RedisScript* script = nullptr;  // not null: the digest of the script is inserted as the second word
    RedisCommand command;
    Acknowledgement acknowledgement = Acknowledgement::kMaster;
    Done done;
    // Not null: these jobs run in place of this one. `done` is called only with an error, which it passes to each of
    // them.
    std::shared_ptr<std::vector<Job>> parts;
  };

  static Job MakeJob(Command command, Done done);
  // A job, and the future reply to it.
  static std::pair<Job, std::future<absl::StatusOr<RedisReply>>> MakeJobWithReply(Command command);
  std::future<absl::StatusOr<RedisReply>> StartCommand(Command command);
  // Replaces each job that has `parts` by these parts.
  static std::vector<Job> Expand(std::vector<Job> jobs);
  void Process(std::vector<Job> waiting);
  // Runs the commands from `begin` on that fit into one batch; `end` is the first one that does not.
  std::vector<absl::StatusOr<RedisReply>> RunBatch(std::vector<Job>& jobs, size_t begin, size_t& end);
  bool AwaitsReplica(const Job& job) const;
  // Converts the reply of WAIT behind commands of this size; sends further ones while no replica acknowledges them.
  absl::Status AwaitReplica(absl::StatusOr<RedisReply> reply, size_t bytes);
  // Repeats a command that failed because Redis did not have its script, or because the memory of Redis was full.
  // Returns whether it was repeated.
  bool RunAgain(const Job& job, absl::StatusOr<RedisReply>& reply);
  // Calls the callbacks of the jobs from `begin` to `end`, except those that were refused and run again: they are moved
  // to the end of this range. Returns the first one of them, or `end`.
  size_t Deliver(std::vector<Job>& jobs, size_t begin, size_t end, std::vector<absl::StatusOr<RedisReply>> replies);
  absl::Status Connect();
  absl::StatusOr<std::unique_ptr<RedisConnection>> OpenConnection();
  // True while the present call may wait for the Sentinels to replace the master.
  bool MayWait() const { return !is_closing_ && std::chrono::steady_clock::now() < wait_until_; }
  void Disconnect();
  // Disconnects after a batch with these replies if the connection is broken or may lead to a node that is no longer
  // the master.
  void DisconnectIfNeeded(const std::vector<absl::StatusOr<RedisReply>>& replies);
  bool DeleteOldestEnded();

  const RedisClientOptions options_;
  std::atomic<bool> is_closing_ = false;
  std::atomic<uint64_t> unreplicated_commits_ = 0;
  // Used by the client's thread only.
  std::unique_ptr<RedisSentinels> sentinels_;  // null without Sentinels
  std::unique_ptr<RedisConnection> connection_;
  std::map<const RedisScript*, std::string> digests_;  // from SCRIPT LOAD on this connection
  absl::Duration backoff_;
  std::chrono::steady_clock::time_point next_connection_;
  std::chrono::steady_clock::time_point wait_until_;
  // True after a failure: calls do not wait for a failover until a replica has acknowledged a command again.
  bool skips_failover_wait_ = false;

  std::mutex mutex_;
  std::vector<std::string> deleted_for_room_ ABSL_GUARDED_BY(mutex_);
  JobThread<Job> thread_;  // the last member, because it uses the others
};

}  // namespace evpose::server
