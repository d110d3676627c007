// SPDX-License-Identifier: Apache-2.0

// The Redis groups of a store, each with its connection. A group is a Redis server, or a master with replicas behind
// Sentinels. Each bucket (redis_keys.h) is in one of the groups, which itself knows that: a script fails in every other
// one, so that servers with different tables cannot write to two places.
#pragma once

#include <array>
#include <atomic>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/functional/any_invocable.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "server/stores/common/job_thread.h"
#include "server/stores/common/store.h"
#include "server/stores/redis/redis_client.h"
#include "server/stores/redis/redis_keys.h"

namespace evpose::server {

struct RedisGroupOptions {
  std::string name;  // empty for the only group of a store
  RedisClientOptions client;
};

struct RedisBucketCall {
  int bucket = 0;
  RedisClient::Command command;  // one that only reads if it has no script
};

RedisBucketCall ReadBucket(int bucket, RedisCommand command);
RedisBucketCall OnSession(const RedisScript& script, absl::string_view name, std::vector<std::string> arguments,
                          Acknowledgement acknowledgement = Acknowledgement::kMaster);
RedisBucketCall OnModel(const RedisScript& script, const std::string& member, std::vector<std::string> arguments);

// Thread-safe.
class RedisGroups {
 public:
  using Done = RedisClient::Done;

  // `groups` has at least one group. The names differ.
  explicit RedisGroups(const std::vector<RedisGroupOptions>& groups);

  // Checks the servers, and finds the buckets or, in an empty store, divides them equally among the groups. A group
  // that does not respond is no error if another one does and the store is not empty. To be called before the other
  // functions. Errors: UNAVAILABLE; PERMISSION_DENIED; FAILED_PRECONDITION for a Redis that the store cannot use, one
  // with the layout without buckets, and one that belongs to another store or is another group of it.
  absl::Status Open();

  // Calls a bucket and waits for the reply; while the bucket moves to another group, up to kMoveWait. Errors, beside
  // those of RedisClient: UNAVAILABLE when the group of the bucket is not known, because it does not respond, or when
  // the bucket still moves.
  absl::StatusOr<RedisReply> Call(const RedisBucketCall& call);
  // Does the same as Call() for several calls, which are sent together.
  std::vector<absl::StatusOr<RedisReply>> CallAll(const std::vector<RedisBucketCall>& calls);
  // The replies of CallAll() without those of groups that do not respond, unless none does.
  absl::StatusOr<std::vector<RedisReply>> CallThoseThatRespond(const std::vector<RedisBucketCall>& calls);
  // Does the same as Call() for a script without waiting: `done` is called once, on a thread of a client, as that of
  // RedisClient::Push().
  void PushScript(RedisBucketCall call, Done done);
  // Calls `done` on a thread of a client.
  void PushNothing(absl::AnyInvocable<void()> done);

  // OK if at least one group responds; the state of each is in groups(). If a group does not respond, finds the buckets
  // that were moved from it.
  absl::Status CheckHealth();
  // The groups in the order of their names.
  std::vector<StoreGroup> groups() const;
  // Asks all groups for their memory. A group that does not report it has no usage.
  std::vector<std::optional<StoreUsage>> Usages();
  // The sum of all groups.
  uint64_t unreplicated_commits() const;
  std::vector<std::string> TakeDeletedForRoom();
  bool has_several() const { return groups_.size() > 1; }

  struct Move {
    int bucket = 0;
    std::string from;
    std::string to;
    size_t keys = 0;  // that were copied
  };
  // Moves buckets until the numbers of buckets of any two groups differ by at most one, and completes interrupted
  // moves. Sessions of a bucket that is moving can neither be committed nor read; servers repeat these calls. All
  // servers must know all groups, and all groups must respond. To be called again after an error. `on_moved` is called
  // after each move. Errors: those of RedisClient.
  absl::Status Divide(const std::function<void(const Move&)>& on_moved);

  // Closes the clients of all groups (RedisClient::Close()).
  void Close();

  // Longest wait of a call for the move of a bucket, which takes about as long as copying the data of its few sessions
  // (server/stores/README.md). A session repeats a commit that fails after it.
  static constexpr absl::Duration kMoveWait = absl::Seconds(2);

 private:
  static constexpr int kUnknownGroup = -1;
  using Table = std::array<int, kRedisBuckets>;  // by bucket the number of the group

  struct Group {
    explicit Group(const RedisGroupOptions& group_options) : options(group_options), client(group_options.client) {}
    // The name for messages.
    std::string Printable() const;

    const RedisGroupOptions options;
    RedisClient client;
    std::atomic<uint64_t> commits = 0;
    std::atomic<uint64_t> commit_us = 0;
  };
  // The records of a group about the store; redis_scripts.h describes them.
  struct Bucket {
    std::string state;
    std::string to;
    uint64_t epoch = 0;

    // False if the group does not have the bucket, or not completely.
    bool is_place() const { return !state.empty() && state != "moved" && state != "arriving"; }
  };
  struct Report {
    absl::Status status;  // an error: the rest is not known
    std::string id;
    std::string name;
    std::string names_at_first;
    std::array<Bucket, kRedisBuckets> buckets;
  };
  struct RefreshRequest {
    void done(const absl::Status&) const {}  // JobThread calls it; nothing waits for a refresh
  };

  // Finds the buckets again, and makes those that no group has.
  absl::Status Refresh();
  // Starts Refresh() on the thread of refresher_, unless it is about to start.
  void RefreshSoon();
  std::vector<Report> AskAll();
  // Writes the records of the store to the groups that lack them. `reports` are updated.
  absl::Status Join(std::vector<Report>& reports);
  // Writes the record of a new store to one group. `reports` are updated.
  absl::Status CreateStore(std::vector<Report>& reports);
  // Makes the buckets that no group has, if all groups have responded. `reports` are updated.
  absl::Status MakeMissingBuckets(std::vector<Report>& reports);
  // Returns the moves that Divide() must make for the buckets in these reports. Errors: UNAVAILABLE when a bucket is in
  // no group.
  absl::StatusOr<std::vector<Move>> PlanMoves(const std::vector<Report>& reports) const;
  absl::Status MoveBucket(Move& move);
  // Copies the keys of a bucket that is moving or leaving, except its state.
  absl::Status CopyKeys(int bucket, const std::vector<std::string>& keys, Group& from, Group& to);
  // The keys of a bucket, except its state, the indexes last.
  static absl::StatusOr<std::vector<std::string>> KeysOf(int bucket, Group& group);
  static absl::Status DeleteKeysOf(int bucket, Group& group);
  // The number of the group with this name, or kUnknownGroup.
  int Find(absl::string_view name) const;
  std::string Names() const;

  int GroupOf(int bucket) const;
  absl::Status UnknownGroupError(int bucket) const;

  std::vector<std::unique_ptr<Group>> groups_;
  std::mutex refresh_mutex_;
  std::atomic<bool> is_refreshing_soon_ = false;
  mutable std::mutex mutex_;
  Table table_ ABSL_GUARDED_BY(mutex_);
  std::vector<absl::Status> health_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::optional<StoreUsage>> usages_ ABSL_GUARDED_BY(mutex_);
  JobThread<RefreshRequest> refresher_;  // the last member, because it uses the others
};

}  // namespace evpose::server
