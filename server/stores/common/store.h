// SPDX-License-Identifier: Apache-2.0

// The interface of a store of models, sessions and poses (server/stores/README.md). The rest of the server uses only
// this interface. Each kind of store is one class, and the same tests run on all kinds (store_suite_test.cc).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/functional/any_invocable.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "core/models/object_model.h"

namespace evpose::server {

// The parameters for parsing a model file. They are part of the digest that is the model's name.
struct ModelReading {
  ModelFormat format = ModelFormat::kObj;
  double metres_per_unit = 1.0;
  double crease_angle_deg = 30.0;
  bool is_smooth = true;  // ModelOptions::is_smooth

  friend bool operator==(const ModelReading&, const ModelReading&) = default;
};

// A model's file, the parameters for parsing it, and what was derived from it. Tenant and name together are the key,
// and determine the file.
struct ModelRecord {
  std::string name;  // "models/{id}"
  std::string tenant;
  ModelReading reading;
  absl::Time create_time;
  std::string summary;      // for lists; opaque to the store; empty if an earlier version stored the model
  uint64_t file_bytes = 0;  // size of `bytes`; set by the store
  std::shared_ptr<const std::vector<uint8_t>> bytes;
  std::string prepared;  // opaque to the store; empty if an earlier version stored the model
};

// The immutable part of a session.
struct SessionRecord {
  std::string name;  // "sessions/{id}"
  std::string tenant;
  std::string request_id;
  absl::Time create_time;
  std::string config;  // serialized configuration; opaque to the store
};

// Consecutive poses, serialized. The store keeps and deletes a segment as a whole.
struct PoseSegment {
  uint64_t first_pose_seq = 0;
  uint64_t last_pose_seq = 0;
  std::string bytes;
};

// An optional immutable string; copies share the bytes.
class SharedBytes {
 public:
  SharedBytes() = default;
  // NOLINTBEGIN(google-explicit-constructor): as std::optional<std::string>.
  SharedBytes(std::string bytes) : bytes_(std::make_shared<const std::string>(std::move(bytes))) {}
  SharedBytes(const char* bytes) : SharedBytes(std::string(bytes)) {}
  // NOLINTEND(google-explicit-constructor)

  bool has_value() const { return bytes_ != nullptr; }
  const std::string& operator*() const { return *bytes_; }
  const std::string* operator->() const { return bytes_.get(); }
  friend bool operator==(const SharedBytes& shared, absl::string_view bytes) {
    return shared.has_value() && *shared == bytes;
  }

 private:
  std::shared_ptr<const std::string> bytes_;
};

// The changes of one atomic write.
struct SessionCommit {
  SharedBytes checkpoint;                // replaces the previous one; several megabytes
  std::optional<std::string> lifecycle;  // replaces the previous one
  // The segments continue the log without a gap: the first pose is the one after the last pose of the last commit that
  // ended with OK, or 1. After UNAVAILABLE it is unknown whether a commit was written; the caller commits its poses
  // again, with or without later ones, and the store replaces poses that it already has.
  std::vector<PoseSegment> poses;
  // Segments that end before this pose are deleted. A lower number than in an earlier commit has no effect.
  uint64_t first_pose_seq_kept = 1;
  // Once set, retention may delete the session, beginning with the earliest end. It cannot be unset.
  std::optional<absl::Time> ended_at;
};

// The bytes of the checkpoint, the lifecycle record and the poses.
uint64_t SizeBytes(const std::vector<PoseSegment>& poses);
uint64_t SizeBytes(const SessionCommit& commit);

struct StoredSession {
  SessionRecord record;
  std::string lifecycle;
  std::string checkpoint;  // empty before the first one
  std::vector<PoseSegment> poses;
};

// The lifecycle record of a session, from which a server sees whether the session has expired.
struct StoredLifecycle {
  std::string name;
  std::string lifecycle;
};

// As `after_pose_seq`: no poses are wanted. No session has so many, and the number fits into those of all databases.
inline constexpr uint64_t kAfterAllPoses = INT64_MAX - 1;

struct SessionOwner {
  std::string name;  // of the session
  std::string tenant;
};

// A part of the list of a tenant's sessions.
struct SessionPage {
  std::vector<SessionRecord> records;  // sorted by name; damaged ones are omitted
  std::string last_name;               // the place in the list after this page; empty at the end of the list
};

// Identifies one lease. A commit is written only if both parts equal those in the store. The number alone is not
// unique: a replica that had missed the last numbers and was made the master gives them out again.
struct FencingToken {
  uint64_t number = 0;  // higher than that of every earlier lease on a session of this name that the store knows
  std::string holder;   // random (RandomHex128), of this lease alone

  friend bool operator==(const FencingToken&, const FencingToken&) = default;
};

// The right to write to a session. A session has one holder; its fencing token distinguishes it from all others.
// Thread-safe. A lease may outlive its store; then Commit() ends with CANCELLED.
class SessionLease {
 public:
  virtual ~SessionLease() = default;

  // The completion callback of Commit(). It is called exactly once from a thread of the store, before or after Commit()
  // has returned; from within Commit() when the store is closed. It must not block or call the store, but it may call
  // Commit(). OK means that the commit is as durable as the store is. After every error but UNAVAILABLE nothing has
  // been written:
  // - ABORTED: another holder has acquired the session.
  // - OUT_OF_RANGE: the store has lost this lease, or a commit of it that ended with OK: a replica without the last
  //   writes was made the master. No other server has the session; the next holder continues from an older state.
  // - NOT_FOUND: the session was deleted.
  // - RESOURCE_EXHAUSTED: the disk or the quota is full; later commits succeed when space is available again.
  // - UNAVAILABLE: the store does not respond. The commit may have been written; see SessionCommit::poses.
  // - FAILED_PRECONDITION: the previous commit is in progress, or the poses do not continue the log.
  // - DATA_LOSS, INTERNAL: the store is damaged; the message is that of the database.
  // - CANCELLED: the store was closed.
  using Done = absl::AnyInvocable<void(absl::Status)>;

  // Writes `commit` atomically. At most one commit may be in progress.
  virtual void Commit(SessionCommit commit, Done done) = 0;

  virtual const FencingToken& token() const = 0;
};

struct StoreUsage {
  uint64_t bytes = 0;
  uint64_t max_bytes = 0;  // 0: no limit
  // Processor time of the store's process since its start, if the store has one of its own and reports it.
  std::optional<double> cpu_s;
};

// One of several groups of servers among which a store divides the sessions.
struct StoreGroup {
  std::string name;
  absl::Status health;              // at the last CheckHealth()
  std::optional<StoreUsage> usage;  // at the last Usage()
  uint32_t parts = 0;               // number of the store's parts (buckets of Redis) that the group has
  // Counts since the start: the commits that the group has completed, the sum of their durations, and
  // unreplicated_commits().
  uint64_t commits = 0;
  double commit_s = 0.0;
  uint64_t unreplicated_commits = 0;
};

enum class StoreKind { kMemory, kSqlite, kRedis, kPostgresql };

// Stores bytes without interpreting them. Thread-safe. All functions but SessionLease::Commit block until the store has
// responded, for a bounded time. Errors of all functions, beside those that they name:
// - UNAVAILABLE: the store does not respond. Every call may be repeated, also one with an effect.
// - RESOURCE_EXHAUSTED: the disk or the quota is full.
// - DATA_LOSS, INTERNAL: the message is that of the database.
// The destructor completes all requests or ends them with CANCELLED; afterwards every completion callback has been
// called.
class Store {
 public:
  virtual ~Store() = default;

  virtual StoreKind kind() const = 0;
  // Several servers use the store, and each of them can acquire any session.
  bool is_shared() const { return kind() == StoreKind::kRedis || kind() == StoreKind::kPostgresql; }
  bool outlives_process() const { return kind() != StoreKind::kMemory; }

  // Returns OK when the store responds; if it has several groups, when one of them does.
  virtual absl::Status CheckHealth() = 0;

  // The bytes in use, in the fullest group if there are several, and the processor time, of all groups; nullopt if the
  // store does not report them.
  virtual std::optional<StoreUsage> Usage() { return std::nullopt; }

  // The groups of the store, in the order of their names; empty for a store that does not divide its sessions. Does not
  // block.
  virtual std::vector<StoreGroup> Groups() const { return {}; }

  // The writes of sessions and models that the store had executed and that ended with UNAVAILABLE because no replica
  // acknowledged them in time, since the start; 0 if the store waits for no replica. Does not block.
  virtual uint64_t unreplicated_commits() const { return 0; }

  // The damaged records that were found when the store was opened and are skipped. One line for each, naming the
  // session or model.
  virtual std::vector<std::string> damage() const = 0;

  // All models whose header is undamaged, sorted by name, then tenant, without `bytes` and `prepared`.
  virtual absl::StatusOr<std::vector<ModelRecord>> ListModels() const = 0;
  // Errors: NOT_FOUND, DATA_LOSS naming the model.
  virtual absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const = 0;
  // Whether the model exists; true also for a damaged one. The time does not depend on the size of the model.
  virtual absl::StatusOr<bool> HasModel(absl::string_view tenant, absl::string_view name) const = 0;
  // Adds a model, or replaces the tenant's model of this name.
  virtual absl::Status PutModel(const ModelRecord& model) = 0;
  // Returns OK also when the model does not exist.
  virtual absl::Status DeleteModel(absl::string_view tenant, absl::string_view name) = 0;

  // Returns a name for a session, "sessions/{id}", that cannot be guessed. Errors: INTERNAL.
  virtual absl::StatusOr<std::string> NewSessionName(absl::string_view tenant, absl::string_view request_id) const;
  // Creates a session and acquires its lease. Errors: ALREADY_EXISTS when the name exists, also from an earlier call
  // that ended with UNAVAILABLE, or when the tenant has a session of the same request_id, which FindRequest() returns.
  // Some stores return INVALID_ARGUMENT when the session has a request_id and its name is not from NewSessionName() for
  // tenant and request_id.
  virtual absl::StatusOr<std::unique_ptr<SessionLease>> CreateSession(const SessionRecord& record,
                                                                      const std::string& lifecycle) = 0;

  struct AcquiredSession {
    StoredSession session;
    std::unique_ptr<SessionLease> lease;
  };
  // Reads a session and acquires its lease with a new fencing token: from now on commits of earlier holders fail with
  // ABORTED. Errors: NOT_FOUND; DATA_LOSS naming the session and the damaged part.
  virtual absl::StatusOr<AcquiredSession> AcquireSession(absl::string_view name) = 0;
  // Reads a session without acquiring its lease. Segments without a pose after `after_pose_seq` are omitted. Errors:
  // those of AcquireSession().
  virtual absl::StatusOr<StoredSession> ReadSession(absl::string_view name, uint64_t after_pose_seq) const = 0;
  absl::StatusOr<StoredSession> ReadSession(absl::string_view name) const { return ReadSession(name, 0); }
  // Reads several sessions without their poses, in the order of `names`, with one round trip, without leases. Sessions
  // that do not exist or are damaged are omitted. The caller bounds their number: a checkpoint may have several
  // megabytes.
  virtual absl::StatusOr<std::vector<StoredSession>> ReadWithoutPoses(const std::vector<std::string>& names) const = 0;
  // The tenant of a session, also of a damaged one. Errors: NOT_FOUND.
  virtual absl::StatusOr<std::string> ReadTenant(absl::string_view name) const = 0;
  // The tenant's sessions from the first name after `after_name` on, at most `max_sessions` with the damaged ones,
  // which are omitted. The time does not depend on the number of other sessions.
  virtual absl::StatusOr<SessionPage> ListSessions(absl::string_view tenant, absl::string_view after_name,
                                                   size_t max_sessions) const = 0;
  // The session that the tenant created with this request_id, which is not empty. The time does not depend on the
  // number of sessions. Errors: NOT_FOUND, DATA_LOSS.
  virtual absl::StatusOr<SessionRecord> FindRequest(absl::string_view tenant, absl::string_view request_id) const = 0;
  // The names and tenants of all sessions, also of damaged ones, without reading their records.
  virtual absl::StatusOr<std::vector<SessionOwner>> ListOwners() const = 0;
  // The lifecycle records that were written least recently, the oldest first, at most `max_sessions`, without damaged
  // ones. Their age is an order of writes and not a time, so that it depends on no clock.
  virtual absl::StatusOr<std::vector<StoredLifecycle>> ReadOldestLifecycles(size_t max_sessions) const = 0;
  // Returns OK also when the session does not exist. Damaged sessions are deleted, too.
  virtual absl::Status DeleteSession(absl::string_view name) = 0;
  // Deletes the session, as DeleteSession() does, but only if the lease with this token holds it. Errors: ABORTED when
  // another holder has acquired it, OUT_OF_RANGE when the store has lost the lease; the session is kept.
  virtual absl::Status DeleteHeldSession(absl::string_view name, const FencingToken& token) = 0;

  // Retention: deletes the sessions that ended before `ended_before`. A full store also deletes ended sessions without
  // a call, beginning with the earliest end. Returns the names of all sessions deleted in either way since the last
  // call.
  virtual absl::StatusOr<std::vector<std::string>> DeleteEnded(absl::Time ended_before) = 0;
};

}  // namespace evpose::server
