// SPDX-License-Identifier: Apache-2.0

// The checks that the leases of all stores make before they write.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Rejects a commit while the previous one is in progress, and poses that do not continue the log.
class CheckedLease : public SessionLease {
 public:
  // `next_pose_seq`: one above the number of the last stored pose, or 1.
  CheckedLease(uint64_t fencing_number, uint64_t next_pose_seq)
      : fencing_number_(fencing_number), progress_(std::make_shared<Progress>(next_pose_seq)) {}

  void Commit(SessionCommit commit, Done done) final;
  uint64_t fencing_number() const final { return fencing_number_; }

 protected:
  // Writes a commit that has passed the checks. Poses that are already stored from `next_pose_seq` on come from a
  // commit that was written although it ended with UNAVAILABLE; the new poses replace them.
  virtual void Write(SessionCommit commit, uint64_t next_pose_seq, Done done) = 0;
  // Calls `done` from a thread of the store.
  virtual void Refuse(absl::Status status, Done done) = 0;

 private:
  // Shared with the callback of a commit in progress, which may outlive the lease.
  struct Progress {
    explicit Progress(uint64_t next) : next_pose_seq(next) {}
    std::mutex mutex;
    bool is_writing ABSL_GUARDED_BY(mutex) = false;
    uint64_t next_pose_seq ABSL_GUARDED_BY(mutex);  // as of the last commit that ended with OK
  };

  const uint64_t fencing_number_;
  const std::shared_ptr<Progress> progress_;
};

// The errors that all stores return in the same words.
// CANCELLED: the store was destroyed before the request was processed.
absl::Status StoreClosedError();
// ABORTED: another holder has taken the session from the lease with this number.
absl::Status FencedError(absl::string_view session, uint64_t fencing_number);
absl::Status SessionNotFoundError(absl::string_view session);
absl::Status SessionExistsError(absl::string_view session);
absl::Status ModelNotFoundError(absl::string_view model);

}  // namespace evpose::server
