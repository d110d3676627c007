// SPDX-License-Identifier: Apache-2.0

// The checks that the leases of all stores make before they write.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// The place of a commit in the sequence of its lease.
struct CommitPlace {
  // Poses that are already stored from this one on come from a commit that was written although it ended with
  // UNAVAILABLE; the new poses replace them.
  uint64_t next_pose_seq = 1;
  uint64_t number = 1;   // 1, 2, 3, ... on the lease, also of commits that failed
  uint64_t last_ok = 0;  // the last number whose commit ended with OK: a store without it was rolled back
};

// Rejects a commit while the previous one is in progress, and poses that do not continue the log.
class CheckedLease : public SessionLease {
 public:
  // `next_pose_seq`: one above the number of the last stored pose, or 1.
  CheckedLease(FencingToken token, uint64_t next_pose_seq)
      : token_(std::move(token)), progress_(std::make_shared<Progress>(next_pose_seq)) {}

  void Commit(SessionCommit commit, Done done) final;
  const FencingToken& token() const final { return token_; }

 protected:
  // Writes a commit that has passed the checks.
  virtual void Write(SessionCommit commit, const CommitPlace& place, Done done) = 0;
  // Calls `done` from a thread of the store.
  virtual void Refuse(absl::Status status, Done done) = 0;

 private:
  // Shared with the callback of a commit in progress, which may outlive the lease.
  struct Progress {
    explicit Progress(uint64_t next) : next_place{.next_pose_seq = next} {}
    std::mutex mutex;
    bool is_writing ABSL_GUARDED_BY(mutex) = false;
    CommitPlace next_place ABSL_GUARDED_BY(mutex);
  };

  const FencingToken token_;
  const std::shared_ptr<Progress> progress_;
};

// The errors that all stores return in the same words.
// CANCELLED: the store was destroyed before the request was processed.
absl::Status StoreClosedError();
// ABORTED: another holder has acquired the session, which the lease with this number held.
absl::Status FencedError(absl::string_view session, uint64_t fencing_number);
// OUT_OF_RANGE: the store has lost the lease with this number, or commits of it.
absl::Status RolledBackError(absl::string_view session, uint64_t fencing_number);
// Checks a write by the lease `own` to a session that `stored` holds. Errors: ABORTED, OUT_OF_RANGE.
absl::Status CheckHolder(absl::string_view session, const FencingToken& stored, const FencingToken& own);
absl::Status SessionNotFoundError(absl::string_view session);
absl::Status SessionExistsError(absl::string_view session);
absl::Status RequestNotFoundError(absl::string_view request_id);
absl::Status ModelNotFoundError(absl::string_view model);

}  // namespace evpose::server
