// SPDX-License-Identifier: Apache-2.0

// The sessions of the memory store.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/store.h"

namespace evpose::server {

struct MemorySession {
  StoredSession stored;
  FencingToken token;
  uint64_t last_commit = 0;    // number of the last commit of the holder
  uint64_t next_pose_seq = 1;  // kept also when all poses have been deleted
  uint64_t first_pose_seq_kept = 1;
  uint64_t lifecycle_write = 0;  // number of the write of the lifecycle record, over all sessions
  std::optional<absl::Time> ended_at;
};

// Sessions by name. Thread-safe. Errors are those of Store and SessionLease.
class MemorySessions {
 public:
  // `max_bytes` bounds the bytes of all sessions together: configurations, lifecycles, checkpoints and poses.
  explicit MemorySessions(uint64_t max_bytes) : max_bytes_(max_bytes) {}

  // `holder`: FencingToken::holder of the lease. Returns its token.
  absl::StatusOr<FencingToken> Create(const SessionRecord& record, const std::string& lifecycle, std::string holder);
  absl::StatusOr<MemorySession> Acquire(absl::string_view name, std::string holder);
  absl::StatusOr<StoredSession> Read(absl::string_view name, uint64_t after_pose_seq) const;
  std::vector<StoredSession> ReadWithoutPoses(const std::vector<std::string>& names) const;
  absl::StatusOr<std::string> ReadTenant(absl::string_view name) const;
  SessionPage List(absl::string_view tenant, absl::string_view after_name, size_t max_sessions) const;
  absl::StatusOr<SessionRecord> FindRequest(absl::string_view tenant, absl::string_view request_id) const;
  std::vector<SessionOwner> ListOwners() const;
  std::vector<StoredLifecycle> ReadOldestLifecycles(size_t max_sessions) const;
  void Delete(absl::string_view name);
  absl::Status DeleteHeld(absl::string_view name, const FencingToken& token);
  std::vector<std::string> DeleteEnded(absl::Time ended_before);
  StoreUsage Usage() const;
  absl::Status Commit(absl::string_view name, const FencingToken& token, const CommitPlace& place,
                      SessionCommit commit);

  // All sessions and the last fencing number: what a replica of a shared store has at some time.
  struct Contents {
    std::map<std::string, MemorySession, std::less<>> sessions;
    std::set<std::pair<std::string, std::string>> names_of_tenants;                // tenant, name
    std::map<std::pair<std::string, std::string>, std::string> names_of_requests;  // by tenant and request_id
    std::map<uint64_t, std::string> names_by_lifecycle_write;
    uint64_t size_bytes = 0;
    uint64_t last_fencing_number = 0;
    uint64_t last_lifecycle_write = 0;
  };
  Contents Copy() const;
  // The stores on these sessions continue with the contents, as after the promotion of a replica. Leases that are not
  // in them are lost.
  void Replace(Contents contents);

 private:
  using Sessions = std::map<std::string, MemorySession, std::less<>>;

  // Deletes ended sessions, beginning with the earliest end, until `more_bytes` fit. Never deletes the session `keep`.
  // Errors: RESOURCE_EXHAUSTED.
  absl::Status MakeRoom(uint64_t more_bytes, absl::string_view keep) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  Sessions::iterator Erase(Sessions::iterator session) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void NoteLifecycleWrite(MemorySession& session) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const uint64_t max_bytes_;
  mutable std::mutex mutex_;
  Contents contents_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::string> deleted_for_room_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
