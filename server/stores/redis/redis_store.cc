// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_store.h"

#include <algorithm>
#include <cstdio>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/base/status_macros.h"
#include "server/runtime/random_name.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/checked_records.h"
#include "server/stores/redis/redis_keys.h"
#include "server/stores/redis/redis_records.h"
#include "server/stores/redis/redis_scripts.h"

namespace evpose::server {
namespace {

// The number of sessions that are listed with one round trip.
constexpr size_t kSessionsPerRoundTrip = 1000;

std::vector<std::string> SessionKeys(absl::string_view name, const char* last) {
  return {RedisSessionKey(name), RedisPosesKey(name), last};
}

std::string ModelMember(absl::string_view tenant, absl::string_view name) { return absl::StrCat(name, "\n", tenant); }

// `owner`: TENANT\nREQUEST_ID.
std::string TenantOfOwner(const std::string& owner) { return owner.substr(0, owner.find('\n')); }

std::vector<std::string> Texts(const redisReply* reply) {
  std::vector<std::string> texts;
  for (size_t i = 0; i < reply->elements; ++i) texts.push_back(RedisText(reply->element[i]));
  std::sort(texts.begin(), texts.end());
  return texts;
}

// The state that the leases share with their store. It lives until the last lease is destroyed.
struct Shared {
  explicit Shared(const RedisStoreOptions& store_options) : options(store_options), client(store_options.client) {}
  std::string SafetyTtl_ms() const { return std::to_string(absl::ToInt64Milliseconds(options.safety_ttl)); }

  const RedisStoreOptions options;
  RedisClient client;
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
    if (commit.checkpoint.has_value()) checkpoint = AddChecksum(CheckpointOf(name_), *commit.checkpoint);
    std::string lifecycle;
    if (commit.lifecycle.has_value()) lifecycle = AddChecksum(LifecycleOf(name_), *std::move(commit.lifecycle));
    std::vector<std::string> arguments = {name_,
                                          std::to_string(token().number),
                                          std::to_string(place.number),
                                          std::to_string(place.next_pose_seq),
                                          std::to_string(commit.first_pose_seq_kept),
                                          std::move(ended_at_us),
                                          shared_->SafetyTtl_ms(),
                                          std::to_string(shared_->options.max_segments),
                                          std::move(checkpoint),
                                          std::move(lifecycle),
                                          token().holder,
                                          std::to_string(place.last_ok)};
    for (PoseSegment& segment : commit.poses) {
      arguments.push_back(std::to_string(segment.first_pose_seq));
      arguments.push_back(std::to_string(segment.last_pose_seq));
      arguments.push_back(
          AddChecksum(PosesOf(name_, segment.first_pose_seq, segment.last_pose_seq), std::move(segment.bytes)));
    }
    shared_->client.PushScript(
        kRedisCommit, {RedisSessionKey(name_), RedisPosesKey(name_), kRedisEndedKey, kRedisLifecycleWritesKey},
        std::move(arguments), Acknowledgement::kReplica,
        [name = name_, number = token().number, done = std::move(done)](absl::StatusOr<RedisReply> reply) mutable {
          done(WriteOutcome(reply, name, number));
        });
  }

  void Refuse(absl::Status status, Done done) override {
    shared_->client.Push({"PING"}, [status = std::move(status), done = std::move(done)](
                                       const absl::StatusOr<RedisReply>&) mutable { done(std::move(status)); });
  }

  const std::shared_ptr<Shared> shared_;
  const std::string name_;
};

class RedisStore : public Store {
 public:
  explicit RedisStore(const RedisStoreOptions& options) : shared_(std::make_shared<Shared>(options)) {}
  ~RedisStore() override { shared_->client.Close(); }

  // Checks the server, and all records unless there are too many. To be called before every other function.
  absl::Status Check() {
    EVPOSE_RETURN_IF_ERROR(CheckServer());
    EVPOSE_RETURN_IF_ERROR(IndexSessionsOfEarlierVersions());
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply num_sessions, shared_->client.Call({"SCARD", kRedisSessionsKey}));
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply num_models, shared_->client.Call({"SCARD", kRedisModelsKey}));
    const auto num_records = static_cast<uint64_t>(num_sessions->integer + num_models->integer);
    if (num_records > shared_->options.max_checked_records) return absl::OkStatus();
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<std::string> sessions, Members(kRedisSessionsKey));
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<std::string> models, Members(kRedisModelsKey));
    // Reads all parts of each session, so that damage is reported at the start and not when a client attaches again.
    for (const std::string& name : sessions) NoteDamage(absl::StrCat("session ", name), ReadSession(name, 0).status());
    for (const std::string& member : models) {
      const auto model = ReadMember(member);
      NoteDamage(absl::StrCat("model ", member.substr(0, member.find('\n'))), model.status());
    }
    return absl::OkStatus();
  }

  StoreKind kind() const override { return StoreKind::kRedis; }
  // With Sentinels a store without a replica is not healthy: no commit would succeed.
  absl::Status CheckHealth() override { return shared_->client.Call({"PING"}, Acknowledgement::kReplica).status(); }
  std::vector<std::string> damage() const override { return damage_; }

  uint64_t unreplicated_commits() const override { return shared_->client.unreplicated_commits(); }

  // nullopt also for a user who may not call INFO.
  std::optional<StoreUsage> Usage() override {
    const absl::StatusOr<RedisReply> reply = shared_->client.Call({"INFO", "memory"});
    if (!reply.ok()) return std::nullopt;
    const std::string text = RedisText(reply->get());
    StoreUsage usage;
    for (const absl::string_view line : absl::StrSplit(text, "\r\n")) {
      const std::pair<absl::string_view, absl::string_view> field = absl::StrSplit(line, absl::MaxSplits(':', 1));
      if (field.first == "used_memory") (void)absl::SimpleAtoi(field.second, &usage.bytes);
      if (field.first == "maxmemory") (void)absl::SimpleAtoi(field.second, &usage.max_bytes);
    }
    return usage;
  }

  absl::StatusOr<std::vector<ModelRecord>> ListModels() const override {
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<std::string> members, Members(kRedisModelsKey));
    std::vector<RedisCommand> commands;
    for (const std::string& member : members) {
      commands.push_back({"HGET", RedisModelKey(member), "header"});
      commands.push_back({"HSTRLEN", RedisModelKey(member), "bytes"});
    }
    const std::vector<absl::StatusOr<RedisReply>> replies = shared_->client.CallAll(std::move(commands));
    std::vector<ModelRecord> models;
    for (size_t i = 0; i < members.size(); ++i) {
      const auto &header = replies[2 * i], &size = replies[2 * i + 1];
      EVPOSE_RETURN_IF_ERROR(header.status());
      EVPOSE_RETURN_IF_ERROR(size.status());
      const auto [name, tenant] = NameAndTenant(members[i]);
      auto model = DecodeModelHeader(tenant, name, RedisText(header->get()), static_cast<uint64_t>((*size)->integer));
      if (model.ok()) models.push_back(*std::move(model));
    }
    return models;
  }

  absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const override {
    return ReadMember(ModelMember(tenant, name));
  }

  absl::Status PutModel(const ModelRecord& model) override {
    const std::string member = ModelMember(model.tenant, model.name);
    return shared_->client
        .CallScript(kRedisPutModel, {RedisModelKey(member), kRedisModelsKey},
                    {member, EncodeModelHeader(model), EncodeModelBytes(model)}, Acknowledgement::kReplica)
        .status();
  }

  absl::Status DeleteModel(absl::string_view tenant, absl::string_view name) override {
    const std::string member = ModelMember(tenant, name);
    return shared_->client
        .CallScript(kRedisDeleteModel, {RedisModelKey(member), kRedisModelsKey}, {member}, Acknowledgement::kReplica)
        .status();
  }

  absl::StatusOr<std::unique_ptr<SessionLease>> CreateSession(const SessionRecord& record,
                                                              const std::string& lifecycle) override {
    FencingToken token;
    EVPOSE_ASSIGN_OR_RETURN(token.holder, RandomHex128());
    EVPOSE_ASSIGN_OR_RETURN(
        const RedisReply reply,
        shared_->client.CallScript(
            kRedisCreate,
            {RedisSessionKey(record.name), kRedisSessionsKey, kRedisFencingKey, kRedisOwnersKey, kRedisTenantsKey,
             kRedisRequestsKey, kRedisLifecycleWritesKey},
            {record.name, EncodeRecord(record), AddChecksum(LifecycleOf(record.name), lifecycle),
             shared_->SafetyTtl_ms(), token.holder, record.tenant, record.request_id, RedisSessionKey("")},
            Acknowledgement::kReplica));
    if (reply->integer == 0) return SessionExistsError(record.name);
    token.number = static_cast<uint64_t>(reply->integer);
    return std::make_unique<RedisLease>(shared_, record.name, std::move(token), /*next_pose_seq=*/1);
  }

  absl::StatusOr<Taken> TakeSession(absl::string_view name) override {
    EVPOSE_ASSIGN_OR_RETURN(std::string holder, RandomHex128());
    EVPOSE_ASSIGN_OR_RETURN(RedisSession session, Read(name, holder, /*after_pose_seq=*/0));
    return Taken{.session = std::move(session.stored),
                 .lease = std::make_unique<RedisLease>(
                     shared_, name, FencingToken{session.fencing_number, std::move(holder)}, session.next_pose_seq)};
  }

  absl::StatusOr<StoredSession> ReadSession(absl::string_view name, uint64_t after_pose_seq) const override {
    EVPOSE_ASSIGN_OR_RETURN(RedisSession session, Read(name, /*holder=*/"", after_pose_seq));
    return std::move(session.stored);
  }

  absl::StatusOr<std::string> ReadTenant(absl::string_view name) const override {
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply, shared_->client.Call({"HGET", kRedisOwnersKey, std::string(name)}));
    if (reply->type == REDIS_REPLY_NIL) return SessionNotFoundError(name);
    return TenantOfOwner(RedisText(reply.get()));
  }

  absl::StatusOr<SessionPage> ListSessions(absl::string_view tenant, absl::string_view after_name,
                                           size_t max_sessions) const override {
    // The entries of the tenant are TENANT\nNAME, and \v is the character after \n.
    EVPOSE_ASSIGN_OR_RETURN(
        const RedisReply reply,
        shared_->client.Call({"ZRANGEBYLEX", kRedisTenantsKey, absl::StrCat("(", tenant, "\n", after_name),
                              absl::StrCat("(", tenant, "\v"), "LIMIT", "0", std::to_string(max_sessions)}));
    std::vector<std::string> names = Texts(reply.get());
    for (std::string& name : names) name.erase(0, tenant.size() + 1);
    SessionPage page;
    if (!names.empty() && names.size() == max_sessions) page.last_name = names.back();
    EVPOSE_ASSIGN_OR_RETURN(page.records, ReadSessions<SessionRecord>(names, "record", DecodeRecord));
    return page;
  }

  absl::StatusOr<SessionRecord> FindRequest(absl::string_view tenant, absl::string_view request_id) const override {
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply,
                            shared_->client.Call({"HGET", kRedisRequestsKey, absl::StrCat(tenant, "\n", request_id)}));
    if (reply->type == REDIS_REPLY_NIL) return RequestNotFoundError(request_id);
    return ReadRecord(RedisText(reply.get()));
  }

  absl::StatusOr<std::vector<SessionOwner>> ListOwners() const override {
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply, shared_->client.Call({"HGETALL", kRedisOwnersKey}));
    std::vector<SessionOwner> owners;
    for (size_t i = 0; i + 1 < reply->elements; i += 2) {
      owners.push_back(
          {.name = RedisText(reply->element[i]), .tenant = TenantOfOwner(RedisText(reply->element[i + 1]))});
    }
    std::sort(owners.begin(), owners.end(), [](const auto& a, const auto& b) { return a.name < b.name; });
    return owners;
  }

  absl::StatusOr<std::vector<StoredLifecycle>> ReadOldestLifecycles(size_t max_sessions) const override {
    // Again here, because servers of an earlier version may still create sessions.
    EVPOSE_RETURN_IF_ERROR(IndexSessionsOfEarlierVersions());
    std::vector<StoredLifecycle> lifecycles;
    for (size_t begin = 0; lifecycles.size() < max_sessions; begin += kSessionsPerRoundTrip) {
      EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply,
                              shared_->client.Call({"ZRANGE", kRedisLifecycleWritesKey, std::to_string(begin),
                                                    std::to_string(begin + kSessionsPerRoundTrip - 1)}));
      std::vector<std::string> names;
      for (size_t i = 0; i < reply->elements; ++i) names.push_back(RedisText(reply->element[i]));
      EVPOSE_ASSIGN_OR_RETURN(auto read, ReadSessions<StoredLifecycle>(names, "lifecycle", DecodeStoredLifecycle));
      std::move(read.begin(), read.end(), std::back_inserter(lifecycles));
      if (names.size() < kSessionsPerRoundTrip) break;
    }
    lifecycles.resize(std::min(lifecycles.size(), max_sessions));
    return lifecycles;
  }

  absl::Status DeleteSession(absl::string_view name) override { return Delete(name, {}); }

  absl::Status DeleteHeldSession(absl::string_view name, const FencingToken& token) override {
    return Delete(name, token);
  }

  absl::StatusOr<std::vector<std::string>> DeleteEnded(absl::Time ended_before) override {
    const std::string limit =
        ended_before == absl::InfiniteFuture() ? "+inf" : std::to_string(absl::ToUnixMicros(ended_before));
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply,
                            shared_->client.CallScript(kRedisDeleteEnded,
                                                       {kRedisEndedKey, kRedisSessionsKey, kRedisOwnersKey,
                                                        kRedisTenantsKey, kRedisRequestsKey, kRedisLifecycleWritesKey},
                                                       {limit, "1000000", RedisSessionKey(""), RedisPosesKey("")}));
    std::vector<std::string> names = shared_->client.TakeDeletedForRoom();
    for (size_t i = 0; i < reply->elements; ++i) names.push_back(RedisText(reply->element[i]));
    return names;
  }

 private:
  // A token without a number: any holder.
  absl::Status Delete(absl::string_view name, const FencingToken& token) const {
    const auto reply = shared_->client.CallScript(
        kRedisDelete,
        {RedisSessionKey(name), RedisPosesKey(name), kRedisEndedKey, kRedisSessionsKey, kRedisOwnersKey,
         kRedisTenantsKey, kRedisRequestsKey, kRedisLifecycleWritesKey},
        {std::string(name), token.number == 0 ? "" : std::to_string(token.number), token.holder},
        Acknowledgement::kReplica);
    return WriteOutcome(reply, name, token.number);
  }

  // Checks the version and the eviction policy of Redis. Without permission for INFO both are assumed to be right.
  absl::Status CheckServer() {
    EVPOSE_RETURN_IF_ERROR(CheckHealth());
    const auto info = shared_->client.Call({"INFO"});
    if (!info.ok()) return absl::IsUnavailable(info.status()) ? info.status() : absl::OkStatus();
    const std::string address = shared_->options.client.address.Printable();
    bool has_limit = false;
    std::string policy = "noeviction";
    int major = 7;
    int minor = 0;
    for (absl::string_view line : absl::StrSplit(RedisText(info->get()), "\r\n")) {
      if (absl::ConsumePrefix(&line, "maxmemory:")) has_limit = line != "0";
      if (absl::ConsumePrefix(&line, "maxmemory_policy:")) policy = std::string(line);
      if (absl::ConsumePrefix(&line, "redis_version:"))
        (void)std::sscanf(std::string(line).c_str(), "%d.%d", &major, &minor);
    }
    if (std::pair(major, minor) < std::pair(6, 2)) {
      return absl::FailedPreconditionError(
          absl::StrCat(address, " is Redis ", major, ".", minor, ": the store needs 6.2 or later"));
    }
    if (!has_limit || policy == "noeviction") return absl::OkStatus();
    return absl::FailedPreconditionError(absl::StrCat(
        address, " evicts sessions when its memory is full (maxmemory-policy ", policy, "): set it to noeviction"));
  }

  void NoteDamage(const std::string& what, const absl::Status& status) {
    if (absl::IsDataLoss(status)) damage_.push_back(absl::StrCat(what, ": ", status.message()));
  }

  absl::StatusOr<std::vector<std::string>> Members(const char* set) const {
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply, shared_->client.Call({"SMEMBERS", set}));
    return Texts(reply.get());
  }

  absl::StatusOr<SessionRecord> ReadRecord(absl::string_view name) const {
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply, shared_->client.Call({"HGET", RedisSessionKey(name), "record"}));
    if (reply->type == REDIS_REPLY_NIL) return SessionNotFoundError(name);
    return DecodeRecord(name, RedisText(reply.get()));
  }

  // Earlier versions have no indexes beside the set of all names. A damaged session is indexed without its tenant, so
  // that it is not read again at each start.
  absl::Status IndexSessionsOfEarlierVersions() const {
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply all, shared_->client.Call({"SCARD", kRedisSessionsKey}));
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply indexed, shared_->client.Call({"HLEN", kRedisOwnersKey}));
    if (all->integer <= indexed->integer) return absl::OkStatus();
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<std::string> names, Members(kRedisSessionsKey));
    for (const std::string& name : names) {
      EVPOSE_ASSIGN_OR_RETURN(const RedisReply known, shared_->client.Call({"HEXISTS", kRedisOwnersKey, name}));
      if (known->integer == 1) continue;
      const auto record = ReadRecord(name);
      if (absl::IsUnavailable(record.status())) return record.status();
      const SessionRecord owner = record.value_or(SessionRecord());
      EVPOSE_RETURN_IF_ERROR(
          shared_->client
              .CallScript(kRedisIndex, {kRedisOwnersKey, kRedisTenantsKey, kRedisRequestsKey, kRedisLifecycleWritesKey},
                          {name, owner.tenant, owner.request_id})
              .status());
    }
    return absl::OkStatus();
  }

  absl::Status DeleteEntriesUnlessExists(const std::string& name) const {
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply, shared_->client.Call({"EXISTS", RedisSessionKey(name)}));
    return reply->integer == 1 ? absl::OkStatus() : Delete(name, {});
  }

  // Reads one field of each session in one round trip, without sessions that are damaged. The entries of a session that
  // Redis has deleted after the safety time are removed.
  template <typename Record>
  absl::StatusOr<std::vector<Record>> ReadSessions(const std::vector<std::string>& names, const char* field,
                                                   absl::StatusOr<Record> (*decode)(absl::string_view,
                                                                                    std::string)) const {
    std::vector<RedisCommand> commands;
    for (const std::string& name : names) commands.push_back({"HGET", RedisSessionKey(name), field});
    const std::vector<absl::StatusOr<RedisReply>> replies = shared_->client.CallAll(std::move(commands));
    std::vector<Record> records;
    for (size_t i = 0; i < names.size(); ++i) {
      EVPOSE_RETURN_IF_ERROR(replies[i].status());
      if ((*replies[i])->type == REDIS_REPLY_NIL) EVPOSE_RETURN_IF_ERROR(DeleteEntriesUnlessExists(names[i]));
      auto record = decode(names[i], RedisText(replies[i]->get()));
      if (record.ok()) records.push_back(*std::move(record));
    }
    return records;
  }

  static std::pair<std::string, std::string> NameAndTenant(const std::string& member) {
    const size_t newline = std::min(member.find('\n'), member.size());
    return {member.substr(0, newline), newline < member.size() ? member.substr(newline + 1) : ""};
  }

  absl::StatusOr<ModelRecord> ReadMember(const std::string& member) const {
    const auto [name, tenant] = NameAndTenant(member);
    EVPOSE_ASSIGN_OR_RETURN(const RedisReply reply,
                            shared_->client.Call({"HMGET", RedisModelKey(member), "header", "bytes"}));
    if (reply->elements != 2 || reply->element[0]->type == REDIS_REPLY_NIL) return ModelNotFoundError(name);
    const std::string bytes = RedisText(reply->element[1]);
    EVPOSE_ASSIGN_OR_RETURN(ModelRecord model,
                            DecodeModelHeader(tenant, name, RedisText(reply->element[0]), bytes.size()));
    EVPOSE_RETURN_IF_ERROR(DecodeModelBytes(bytes, model));
    return model;
  }

  // Takes the session if there is a holder.
  absl::StatusOr<RedisSession> Read(absl::string_view name, const std::string& holder, uint64_t after_pose_seq) const {
    EVPOSE_ASSIGN_OR_RETURN(
        const RedisReply reply,
        shared_->client.CallScript(kRedisRead, SessionKeys(name, kRedisFencingKey),
                                   {holder.empty() ? "0" : "1", shared_->SafetyTtl_ms(), std::to_string(after_pose_seq),
                                    std::to_string(after_pose_seq + 1), holder},
                                   holder.empty() ? Acknowledgement::kMaster : Acknowledgement::kReplica));
    return ParseRedisSession(name, after_pose_seq, reply.get());
  }

  const std::shared_ptr<Shared> shared_;
  std::vector<std::string> damage_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Store>> OpenRedisStore(const RedisStoreOptions& options) {
  auto store = std::make_unique<RedisStore>(options);
  const absl::Status status = store->Check();
  if (absl::IsUnavailable(status) && options.client.address.sentinels.empty()) {
    return absl::UnavailableError(absl::StrCat(status.message(), ": start Redis there, or give --store its address"));
  }
  EVPOSE_RETURN_IF_ERROR(status);
  return store;
}

}  // namespace evpose::server
