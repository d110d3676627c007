// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_store.h"

#include <algorithm>
#include <iterator>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/runtime/random_name.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/checked_records.h"
#include "server/stores/redis/redis_bucket_merge.h"
#include "server/stores/redis/redis_groups.h"
#include "server/stores/redis/redis_keys.h"
#include "server/stores/redis/redis_models.h"
#include "server/stores/redis/redis_records.h"
#include "server/stores/redis/redis_scripts.h"

namespace evpose::server {
namespace {

// The number of sessions that are read in one round trip, one field each.
constexpr size_t kSessionsPerRoundTrip = 1000;
// On average, one of 256 random names is in the bucket of a request. The probability that none of so many names is in
// it is 1e-170.
constexpr int kMaxDrawnNames = 100'000;

// `owner`: TENANT\nREQUEST_ID.
std::string TenantOfOwner(const std::string& owner) { return owner.substr(0, owner.find('\n')); }

// The state that the leases share with their store. It lives until the last lease is destroyed.
struct Shared {
  explicit Shared(const RedisStoreOptions& store_options) : options(store_options), groups(GroupsOf(store_options)) {}
  std::string SafetyTtlMs() const { return std::to_string(absl::ToInt64Milliseconds(options.safety_ttl)); }
  static std::vector<RedisGroupOptions> GroupsOf(const RedisStoreOptions& options) {
    if (!options.groups.empty()) return options.groups;
    return {{.name = "", .client = options.client}};
  }

  const RedisStoreOptions options;
  RedisGroups groups;
};

// Converts the reply of kRedisCommit or kRedisDelete.
absl::Status WriteOutcome(const absl::StatusOr<RedisReply>& reply, absl::string_view name, uint64_t fencing_number) {
  EVPOSE_RETURN_IF_ERROR(reply.status());
  const std::string word = RedisText(reply->get());
  if (word == "OK") return absl::OkStatus();
  if (word == "NOTFOUND") return SessionNotFoundError(name);
  if (word == "FENCED") return FencedError(name, fencing_number);
  if (word == "LOST") return RolledBackError(name, fencing_number);
  return absl::UnavailableError(absl::StrCat("a commit of ", name, " arrived after a later one: ", word));
}

class RedisLease : public CheckedLease {
 public:
  RedisLease(std::shared_ptr<Shared> shared, absl::string_view name, FencingToken token, uint64_t next_pose_seq)
      : CheckedLease(std::move(token), next_pose_seq), shared_(std::move(shared)), name_(name) {}

 private:
  void Write(SessionCommit commit, const CommitPlace& place, Done done) override {
    std::string ended_at_us;
    if (commit.ended_at.has_value()) ended_at_us = std::to_string(absl::ToUnixMicros(*commit.ended_at));
    std::string checkpoint;
    if (commit.checkpoint.has_value()) checkpoint = CopyWithChecksum(CheckpointOf(name_), *commit.checkpoint);
    std::string lifecycle;
    if (commit.lifecycle.has_value()) lifecycle = AddChecksum(LifecycleOf(name_), *std::move(commit.lifecycle));
    std::vector<std::string> arguments = {name_,
                                          std::to_string(token().number),
                                          std::to_string(place.number),
                                          std::to_string(place.next_pose_seq),
                                          std::to_string(commit.first_pose_seq_kept),
                                          std::move(ended_at_us),
                                          shared_->SafetyTtlMs(),
                                          std::to_string(shared_->options.max_segments)};
    arguments.push_back(std::move(checkpoint));  // a list in braces would be copied, and this one is large
    arguments.insert(arguments.end(), {std::move(lifecycle), token().holder, std::to_string(place.last_ok)});
    for (PoseSegment& segment : commit.poses) {
      arguments.push_back(std::to_string(segment.first_pose_seq));
      arguments.push_back(std::to_string(segment.last_pose_seq));
      arguments.push_back(
          AddChecksum(PosesOf(name_, segment.first_pose_seq, segment.last_pose_seq), std::move(segment.bytes)));
    }
    shared_->groups.PushScript(
        OnSession(kRedisCommit, name_, std::move(arguments), Acknowledgement::kReplica),
        [name = name_, number = token().number, done = std::move(done)](absl::StatusOr<RedisReply> reply) mutable {
          done(WriteOutcome(reply, name, number));
        });
  }

  void Refuse(absl::Status status, Done done) override {
    shared_->groups.PushNothing(
        [status = std::move(status), done = std::move(done)]() mutable { done(std::move(status)); });
  }

  const std::shared_ptr<Shared> shared_;
  const std::string name_;
};

class RedisStore : public Store {
 public:
  explicit RedisStore(const RedisStoreOptions& options) : shared_(std::make_shared<Shared>(options)) {}
  ~RedisStore() override { shared_->groups.Close(); }

  // Checks the groups, and all records unless there are too many. To be called before every other function.
  absl::Status Check() {
    EVPOSE_RETURN_IF_ERROR(shared_->groups.Open());
    std::vector<RedisBucketCall> calls;
    for (int bucket = 0; bucket < kRedisBuckets; ++bucket) {
      calls.push_back(ReadBucket(bucket, {"HLEN", RedisOwnersKey(bucket)}));
      calls.push_back(ReadBucket(bucket, {"SCARD", RedisModelsKey(bucket)}));
    }
    uint64_t num_records = 0;
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<RedisReply> sizes, shared_->groups.CallThoseThatRespond(calls));
    for (const RedisReply& size : sizes) num_records += static_cast<uint64_t>(size->integer);
    if (num_records == 0 || num_records > shared_->options.max_checked_records) return absl::OkStatus();
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<SessionOwner> sessions,
                            ReadOwners(RedisBucketMerge::UnreachableGroup::kIsSkipped));
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<std::string> models, models_.Members());
    // Reads all parts of each session, so that damage is reported at the start and not when a client attaches again.
    for (const SessionOwner& session : sessions) {
      NoteDamage(absl::StrCat("session ", session.name), ReadSession(session.name, 0).status(), damage_);
    }
    for (const std::string& member : models) {
      const auto model = models_.Read(member);
      NoteDamage(absl::StrCat("model ", member.substr(0, member.find('\n'))), model.status(), damage_);
    }
    return absl::OkStatus();
  }

  StoreKind kind() const override { return StoreKind::kRedis; }
  // With Sentinels a group without a replica is not healthy: no commit would succeed.
  absl::Status CheckHealth() override { return shared_->groups.CheckHealth(); }
  std::vector<std::string> damage() const override { return damage_; }
  uint64_t unreplicated_commits() const override { return shared_->groups.unreplicated_commits(); }

  std::vector<StoreGroup> Groups() const override {
    return shared_->groups.has_several() ? shared_->groups.groups() : std::vector<StoreGroup>();
  }

  std::optional<StoreUsage> Usage() override {
    std::optional<StoreUsage> fullest;
    double cpu_s = 0.0;
    bool knows_cpu = true;
    for (const std::optional<StoreUsage>& usage : shared_->groups.Usages()) {
      if (usage.has_value() && (!fullest.has_value() || IsFuller(*usage, *fullest))) fullest = usage;
      knows_cpu = knows_cpu && usage.has_value() && usage->cpu_s.has_value();
      if (knows_cpu) cpu_s += *usage->cpu_s;
    }
    if (fullest.has_value()) fullest->cpu_s = knows_cpu ? std::optional(cpu_s) : std::nullopt;
    return fullest;
  }

  absl::StatusOr<std::vector<ModelRecord>> ListModels() const override { return models_.List(); }

  absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const override {
    return models_.Read(RedisModelMember(tenant, name));
  }

  absl::StatusOr<bool> HasModel(absl::string_view tenant, absl::string_view name) const override {
    return models_.Has(RedisModelMember(tenant, name));
  }

  absl::Status PutModel(const ModelRecord& model) override { return models_.Put(model); }

  absl::Status DeleteModel(absl::string_view tenant, absl::string_view name) override {
    return models_.Delete(RedisModelMember(tenant, name));
  }

  absl::StatusOr<std::string> NewSessionName(absl::string_view tenant, absl::string_view request_id) const override {
    for (int i = 0; i < kMaxDrawnNames; ++i) {
      EVPOSE_ASSIGN_OR_RETURN(std::string name, Store::NewSessionName(tenant, request_id));
      if (request_id.empty() || IsPlaceOf(tenant, request_id, name)) return name;
    }
    return absl::InternalError("the source of random numbers gives no name for a session");
  }

  absl::StatusOr<std::unique_ptr<SessionLease>> CreateSession(const SessionRecord& record,
                                                              const std::string& lifecycle) override {
    if (!record.request_id.empty() && !IsPlaceOf(record.tenant, record.request_id, record.name)) {
      return absl::InvalidArgumentError(absl::StrCat(record.name, " is not in the bucket of its request_id"));
    }
    FencingToken token;
    EVPOSE_ASSIGN_OR_RETURN(token.holder, RandomHex128());
    const auto create = [&] {
      return shared_->groups.Call(
          OnSession(kRedisCreate, record.name,
                    {record.name, EncodeRecord(record), AddChecksum(LifecycleOf(record.name), lifecycle),
                     shared_->SafetyTtlMs(), token.holder, record.tenant, record.request_id},
                    Acknowledgement::kReplica));
    };
    EVPOSE_ASSIGN_OR_RETURN(RedisReply reply, create());
    if (reply->type == REDIS_REPLY_STRING) {
      // The session of the request may be one that Redis has deleted after the safety time.
      const std::string of_request = RedisText(reply.get());
      EVPOSE_ASSIGN_OR_RETURN(const bool is_deleted, DeleteEntriesUnlessExists(of_request));
      if (!is_deleted) return SessionExistsError(of_request);
      EVPOSE_ASSIGN_OR_RETURN(reply, create());
    }
    if (reply->integer == 0) return SessionExistsError(record.name);
    token.number = static_cast<uint64_t>(reply->integer);
    return std::make_unique<RedisLease>(shared_, record.name, std::move(token), /*next_pose_seq=*/1);
  }

  absl::StatusOr<AcquiredSession> AcquireSession(absl::string_view name) override {
    EVPOSE_ASSIGN_OR_RETURN(std::string holder, RandomHex128());
    EVPOSE_ASSIGN_OR_RETURN(RedisSession session, Read(name, holder, /*after_pose_seq=*/0));
    return AcquiredSession{
        .session = std::move(session.stored),
        .lease = std::make_unique<RedisLease>(shared_, name, FencingToken{session.fencing_number, std::move(holder)},
                                              session.next_pose_seq)};
  }

  absl::StatusOr<StoredSession> ReadSession(absl::string_view name, uint64_t after_pose_seq) const override {
    EVPOSE_ASSIGN_OR_RETURN(RedisSession session, Read(name, /*holder=*/"", after_pose_seq));
    return std::move(session.stored);
  }

  absl::StatusOr<std::vector<StoredSession>> ReadWithoutPoses(const std::vector<std::string>& names) const override {
    std::vector<RedisBucketCall> calls;
    for (const std::string& name : names) calls.push_back(ReadCall(name, /*holder=*/"", kAfterAllPoses));
    const std::vector<absl::StatusOr<RedisReply>> replies = shared_->groups.CallAll(calls);
    std::vector<StoredSession> sessions;
    for (size_t i = 0; i < names.size(); ++i) {
      EVPOSE_RETURN_IF_ERROR(replies[i].status());
      auto read = ParseRedisSession(names[i], kAfterAllPoses, replies[i]->get());
      if (IsMissingOrDamaged(read.status())) continue;
      EVPOSE_RETURN_IF_ERROR(read.status());
      sessions.push_back(std::move(read->stored));
    }
    return sessions;
  }

  absl::StatusOr<std::string> ReadTenant(absl::string_view name) const override {
    const int bucket = RedisBucketOf(name);
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply, shared_->groups.Call(ReadBucket(
                                                        bucket, {"HGET", RedisOwnersKey(bucket), std::string(name)})));
    if (reply->type == REDIS_REPLY_NIL) return SessionNotFoundError(name);
    return TenantOfOwner(RedisText(reply.get()));
  }

  absl::StatusOr<SessionPage> ListSessions(absl::string_view tenant, absl::string_view after_name,
                                           size_t max_sessions) const override {
    // The entries of the tenant are TENANT\nNAME, and \v is the character after \n.
    const std::string begin = absl::StrCat("(", tenant, "\n", after_name);
    const std::string end = absl::StrCat("(", tenant, "\v");
    RedisBucketMerge merge(
        shared_->groups,
        [&](int bucket, const RedisListEntry* after, size_t count) -> RedisCommand {
          return {"ZRANGEBYLEX",
                  RedisTenantsKey(bucket),
                  after == nullptr ? begin : absl::StrCat("(", after->text),
                  end,
                  "LIMIT",
                  "0",
                  std::to_string(count)};
        },
        RedisBucketMerge::Scores::kNone, RedisBucketMerge::UnreachableGroup::kIsAnError);
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<RedisListEntry> entries, merge.Next(max_sessions));
    std::vector<std::string> names;
    for (const RedisListEntry& entry : entries) names.push_back(entry.text.substr(tenant.size() + 1));
    SessionPage page;
    if (!names.empty() && names.size() == max_sessions) page.last_name = names.back();
    EVPOSE_ASSIGN_OR_RETURN(page.records, ReadSessions<SessionRecord>(names, "record", DecodeRecord));
    return page;
  }

  absl::StatusOr<SessionRecord> FindRequest(absl::string_view tenant, absl::string_view request_id) const override {
    const std::string request = RedisRequest(tenant, request_id);
    const int bucket = RedisBucketOf(request);
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply,
                            shared_->groups.Call(ReadBucket(bucket, {"HGET", RedisRequestsKey(bucket), request})));
    if (reply->type == REDIS_REPLY_NIL) return RequestNotFoundError(request_id);
    return ReadRecord(RedisText(reply.get()));
  }

  absl::StatusOr<std::vector<SessionOwner>> ListOwners() const override {
    return ReadOwners(RedisBucketMerge::UnreachableGroup::kIsAnError);
  }

  // The sessions of groups that do not respond are left out.
  absl::StatusOr<std::vector<StoredLifecycle>> ReadOldestLifecycles(size_t max_sessions) const override {
    RedisBucketMerge merge(
        shared_->groups,
        [](int bucket, const RedisListEntry* after, size_t count) -> RedisCommand {
          const std::string begin = after == nullptr ? "-inf" : absl::StrCat("(", after->score_text);
          return {"ZRANGEBYSCORE",      RedisLifecycleWritesKey(bucket), begin, "+inf", "WITHSCORES", "LIMIT", "0",
                  std::to_string(count)};
        },
        RedisBucketMerge::Scores::kWith, RedisBucketMerge::UnreachableGroup::kIsSkipped);
    std::vector<StoredLifecycle> lifecycles;
    while (lifecycles.size() < max_sessions) {
      const size_t num_wanted = std::min(kSessionsPerRoundTrip, max_sessions - lifecycles.size());
      EVPOSE_ASSIGN_OR_RETURN(const std::vector<RedisListEntry> entries, merge.Next(num_wanted));
      std::vector<std::string> names;
      for (const RedisListEntry& entry : entries) names.push_back(entry.text);
      EVPOSE_ASSIGN_OR_RETURN(auto read, ReadSessions<StoredLifecycle>(names, "lifecycle", DecodeStoredLifecycle));
      std::move(read.begin(), read.end(), std::back_inserter(lifecycles));
      if (names.size() < num_wanted) break;
    }
    return lifecycles;
  }

  absl::Status DeleteSession(absl::string_view name) override { return Delete(name, {}); }

  absl::Status DeleteHeldSession(absl::string_view name, const FencingToken& token) override {
    return Delete(name, token);
  }

  // The sessions of groups that do not respond are left out.
  absl::StatusOr<std::vector<std::string>> DeleteEnded(absl::Time ended_before) override {
    const std::string limit =
        ended_before == absl::InfiniteFuture() ? "+inf" : std::to_string(absl::ToUnixMicros(ended_before));
    std::vector<RedisBucketCall> calls;
    for (int bucket = 0; bucket < kRedisBuckets; ++bucket) {
      calls.push_back(ReadBucket(bucket, {"ZRANGEBYSCORE", RedisEndedKey(bucket), "-inf",
                                          limit == "+inf" ? limit : absl::StrCat("(", limit)}));
    }
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<RedisReply> ended, shared_->groups.CallThoseThatRespond(calls));
    std::vector<std::string> names;
    for (const RedisReply& of_bucket : ended) {
      for (std::string& name : RedisTexts(of_bucket.get())) names.push_back(std::move(name));
    }
    calls.clear();
    for (const std::string& name : names) calls.push_back(OnSession(kRedisDeleteEnded, name, {name, limit}));
    const std::vector<absl::StatusOr<RedisReply>> replies = shared_->groups.CallAll(calls);
    std::vector<std::string> deleted = shared_->groups.TakeDeletedForRoom();
    for (size_t i = 0; i < names.size(); ++i) {
      // The rest is deleted by the next call.
      if (replies[i].ok() && RedisText(replies[i]->get()) == "OK") deleted.push_back(std::move(names[i]));
    }
    std::sort(deleted.begin(), deleted.end());
    return deleted;
  }

 private:
  static bool IsPlaceOf(absl::string_view tenant, absl::string_view request_id, absl::string_view name) {
    return RedisBucketOf(name) == RedisBucketOf(RedisRequest(tenant, request_id));
  }

  // True if `a` uses more of its limit; one without a limit is the least full.
  static bool IsFuller(const StoreUsage& a, const StoreUsage& b) {
    const auto share = [](const StoreUsage& usage) {
      return usage.max_bytes == 0 ? 0.0 : static_cast<double>(usage.bytes) / static_cast<double>(usage.max_bytes);
    };
    return std::pair(share(a), a.bytes) > std::pair(share(b), b.bytes);
  }

  // A token without a number: any holder.
  absl::Status Delete(absl::string_view name, const FencingToken& token) const {
    const auto reply = shared_->groups.Call(OnSession(
        kRedisDelete, name, {std::string(name), token.number == 0 ? "" : std::to_string(token.number), token.holder},
        Acknowledgement::kReplica));
    return WriteOutcome(reply, name, token.number);
  }

  absl::StatusOr<std::vector<SessionOwner>> ReadOwners(RedisBucketMerge::UnreachableGroup unreachable_group) const {
    std::vector<SessionOwner> owners;
    std::vector<RedisBucketCall> calls;
    for (int bucket = 0; bucket < kRedisBuckets; ++bucket) {
      calls.push_back(ReadBucket(bucket, {"HGETALL", RedisOwnersKey(bucket)}));
    }
    std::vector<RedisReply> hashes;
    if (unreachable_group == RedisBucketMerge::UnreachableGroup::kIsSkipped) {
      EVPOSE_ASSIGN_OR_RETURN(hashes, shared_->groups.CallThoseThatRespond(calls));
    } else {
      for (absl::StatusOr<RedisReply>& reply : shared_->groups.CallAll(calls)) {
        EVPOSE_RETURN_IF_ERROR(reply.status());
        hashes.push_back(*std::move(reply));
      }
    }
    for (const RedisReply& hash : hashes) {
      for (size_t i = 0; i + 1 < hash->elements; i += 2) {
        owners.push_back(
            {.name = RedisText(hash->element[i]), .tenant = TenantOfOwner(RedisText(hash->element[i + 1]))});
      }
    }
    std::sort(owners.begin(), owners.end(), [](const auto& a, const auto& b) { return a.name < b.name; });
    return owners;
  }

  absl::StatusOr<SessionRecord> ReadRecord(absl::string_view name) const {
    EVPOSE_ASSIGN_OR_RETURN(
        const RedisReply reply,
        shared_->groups.Call(ReadBucket(RedisBucketOf(name), {"HGET", RedisSessionKey(name), "record"})));
    if (reply->type == REDIS_REPLY_NIL) return SessionNotFoundError(name);
    return DecodeRecord(name, RedisText(reply.get()));
  }

  // Returns whether it has deleted the entries of the session in the indexes.
  absl::StatusOr<bool> DeleteEntriesUnlessExists(const std::string& name) const {
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply,
                            shared_->groups.Call(ReadBucket(RedisBucketOf(name), {"EXISTS", RedisSessionKey(name)})));
    if (reply->integer == 1) return false;
    EVPOSE_RETURN_IF_ERROR(Delete(name, {}));
    return true;
  }

  // Reads one field of each session in one round trip, without sessions that are damaged. The entries of a session that
  // Redis has deleted after the safety time are removed.
  template <typename Record>
  absl::StatusOr<std::vector<Record>> ReadSessions(const std::vector<std::string>& names, const char* field,
                                                   absl::StatusOr<Record> (*decode)(absl::string_view,
                                                                                    std::string)) const {
    std::vector<RedisBucketCall> calls;
    for (const std::string& name : names) {
      calls.push_back(ReadBucket(RedisBucketOf(name), {"HGET", RedisSessionKey(name), field}));
    }
    const std::vector<absl::StatusOr<RedisReply>> replies = shared_->groups.CallAll(calls);
    std::vector<Record> records;
    for (size_t i = 0; i < names.size(); ++i) {
      EVPOSE_RETURN_IF_ERROR(replies[i].status());
      if ((*replies[i])->type == REDIS_REPLY_NIL) {
        EVPOSE_RETURN_IF_ERROR(DeleteEntriesUnlessExists(names[i]).status());
        continue;
      }
      auto record = decode(names[i], RedisText(replies[i]->get()));
      if (record.ok()) records.push_back(*std::move(record));
    }
    return records;
  }

  // The call that reads a session, and acquires its lease if `holder` is not empty.
  RedisBucketCall ReadCall(absl::string_view name, const std::string& holder, uint64_t after_pose_seq) const {
    return OnSession(kRedisRead, name,
                     {holder.empty() ? "0" : "1", shared_->SafetyTtlMs(), std::to_string(after_pose_seq),
                      std::to_string(after_pose_seq + 1), holder},
                     holder.empty() ? Acknowledgement::kMaster : Acknowledgement::kReplica);
  }
  absl::StatusOr<RedisSession> Read(absl::string_view name, const std::string& holder, uint64_t after_pose_seq) const {
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply, shared_->groups.Call(ReadCall(name, holder, after_pose_seq)));
    return ParseRedisSession(name, after_pose_seq, reply.get());
  }

  const std::shared_ptr<Shared> shared_;
  RedisModels models_{shared_->groups};
  std::vector<std::string> damage_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Store>> OpenRedisStore(const RedisStoreOptions& options) {
  auto store = std::make_unique<RedisStore>(options);
  const absl::Status status = store->Check();
  if (absl::IsUnavailable(status) && options.groups.empty() && options.client.address.sentinels.empty()) {
    return absl::UnavailableError(absl::StrCat(status.message(), ": start Redis there, or give --store its address"));
  }
  EVPOSE_RETURN_IF_ERROR(status);
  return store;
}

}  // namespace evpose::server
