// SPDX-License-Identifier: Apache-2.0

// Where models, sessions and poses are kept. Sessions and services see this interface only; each kind of store is one
// class, and all pass store_suite_test.cc.
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

// A model's file and how it is to be read. Told apart by tenant and name.
struct ModelRecord {
  std::string name;  // "models/{id}"
  std::string tenant;
  ModelFormat format = ModelFormat::kObj;
  double metres_per_unit = 1.0;
  double crease_angle_deg = 30.0;
  absl::Time create_time;
  std::shared_ptr<const std::vector<uint8_t>> bytes;
};

// What never changes about a session.
struct SessionRecord {
  std::string name;  // "sessions/{id}"
  std::string tenant;
  std::string request_id;
  absl::Time create_time;
  std::string config;  // opaque
};

// Poses in a row, opaque: the store keeps and forgets them as one.
struct PoseSegment {
  uint64_t first_pose_seq = 0;
  uint64_t last_pose_seq = 0;
  std::string bytes;
};

// Bytes, or none; copies share them.
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

// What is written together, wholly or not at all.
struct SessionCommit {
  SharedBytes checkpoint;                // replaces the last one; large
  std::optional<std::string> lifecycle;  // replaces the last one
  // Continue the log without a gap: the first has the number after the last pose of the last commit that ended OK,
  // or 1. So what was in a commit that ended UNAVAILABLE is committed again, alone or with more behind it, whether it
  // arrived or not: nothing is there twice.
  std::vector<PoseSegment> poses;
  uint64_t first_pose_seq_kept = 1;  // segments wholly below are forgotten; a lower number than before changes nothing
  // Once set, retention may delete the session, oldest end first. It stays set.
  std::optional<absl::Time> ended_at;
};

struct StoredSession {
  SessionRecord record;
  std::string lifecycle;
  std::string checkpoint;  // empty before the first
  std::vector<PoseSegment> poses;
};

// What tells whether a session is needed still.
struct StoredLifecycle {
  std::string name;
  std::string lifecycle;
};

// The right to write a session: one holder, told apart from those before by a fencing number. Thread-safe. May outlive
// its store, whose end it sees as CANCELLED.
class SessionLease {
 public:
  virtual ~SessionLease() = default;

  // Called exactly once, from a thread of the store, after Commit has returned or before; from within Commit when the
  // store is closed. It must not block nor call the store, but may Commit. OK: the commit is as durable as the store
  // is. Errors, of which all but UNAVAILABLE mean that nothing was written:
  // - ABORTED: another holder has taken the session.
  // - NOT_FOUND: the session was deleted.
  // - RESOURCE_EXHAUSTED: disk or quota full; later commits succeed when there is room again.
  // - UNAVAILABLE: the store does not answer. It may have been written; see SessionCommit::poses.
  // - FAILED_PRECONDITION: the last commit is not done yet, or the poses do not continue the log.
  // - DATA_LOSS, INTERNAL: the store is damaged, in its own words.
  // - CANCELLED: the store was closed.
  using Done = absl::AnyInvocable<void(absl::Status)>;

  // At most one commit at a time.
  virtual void Commit(SessionCommit commit, Done done) = 0;

  // Higher than that of every lease before on any session of this name.
  virtual uint64_t fencing_number() const = 0;
};

// Knows bytes, not tracking. Thread-safe. All functions but Commit block until the store has answered, for a bounded
// time. Errors of all of them, beside those they name: UNAVAILABLE the store does not answer (may be tried again, also
// when it has an effect), RESOURCE_EXHAUSTED disk or quota full, DATA_LOSS or INTERNAL in the store's own words.
// Destroying it finishes what was asked for, or ends it with CANCELLED; every `done` has been called then.
class Store {
 public:
  virtual ~Store() = default;

  virtual absl::string_view kind() const = 0;  // "memory", "sqlite", "redis"

  // OK when the store answers.
  virtual absl::Status CheckHealth() = 0;

  // What was found damaged at opening and is left out, one line each, naming the session or model.
  virtual std::vector<std::string> damage() const = 0;

  // All undamaged models, in the order of their names, then tenants.
  virtual absl::StatusOr<std::vector<ModelRecord>> ReadModels() const = 0;
  // Errors: NOT_FOUND, DATA_LOSS naming the model.
  virtual absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const = 0;
  // Putting a name of a tenant again changes nothing.
  virtual absl::Status PutModel(const ModelRecord& model) = 0;
  // Deleting what is not there is OK.
  virtual absl::Status DeleteModel(absl::string_view tenant, absl::string_view name) = 0;

  // Errors: ALREADY_EXISTS for a name that is taken, also by a call that ended UNAVAILABLE. Whether a request_id is
  // known is the caller's business.
  virtual absl::StatusOr<std::unique_ptr<SessionLease>> CreateSession(const SessionRecord& record,
                                                                      const std::string& lifecycle) = 0;

  struct Taken {
    StoredSession session;
    std::unique_ptr<SessionLease> lease;
  };
  // With a higher fencing number: from now on whoever held the session is refused. Errors: NOT_FOUND, DATA_LOSS naming
  // the session and what of it is damaged.
  virtual absl::StatusOr<Taken> TakeSession(absl::string_view name) = 0;
  // Without taking it, and without the segments that have no pose after this one. Errors: as TakeSession.
  virtual absl::StatusOr<StoredSession> ReadSession(absl::string_view name, uint64_t after_pose_seq) const = 0;
  absl::StatusOr<StoredSession> ReadSession(absl::string_view name) const { return ReadSession(name, 0); }
  // All undamaged sessions, in the order of their names.
  virtual absl::StatusOr<std::vector<SessionRecord>> ListSessions() const = 0;
  // Of all sessions, but those of which it is damaged, in the order of their names.
  virtual absl::StatusOr<std::vector<StoredLifecycle>> ReadLifecycles() const = 0;
  // Deleting what is not there is OK. Also deletes what is damaged.
  virtual absl::Status DeleteSession(absl::string_view name) = 0;
  // The same, unless another holder than the lease with this fencing number has taken it: ABORTED, and it stays.
  virtual absl::Status DeleteHeldSession(absl::string_view name, uint64_t fencing_number) = 0;

  // Retention. Deletes the sessions that ended before `ended_before` and, oldest end first, those that had or have to
  // go for room, also since the last call: a full store does not wait for one. Returns the names of all of them.
  virtual absl::StatusOr<std::vector<std::string>> DeleteEnded(absl::Time ended_before) = 0;
};

}  // namespace evpose::server
