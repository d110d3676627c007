// SPDX-License-Identifier: Apache-2.0

// What every store's lease has to check before it writes.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Refuses a commit while another is on its way, and poses that do not continue the log.
class CheckedLease : public SessionLease {
 public:
  // `next_pose_seq`: one above the last pose stored, or 1.
  CheckedLease(uint64_t fencing_number, uint64_t next_pose_seq)
      : fencing_number_(fencing_number), progress_(std::make_shared<Progress>(next_pose_seq)) {}

  void Commit(SessionCommit commit, Done done) final;
  uint64_t fencing_number() const final { return fencing_number_; }

 protected:
  // Poses stored from `next_pose_seq` on are those of a commit that was written though it ended UNAVAILABLE: to be
  // replaced by these.
  virtual void Write(SessionCommit commit, uint64_t next_pose_seq, Done done) = 0;
  // Calls `done` from a thread of the store.
  virtual void Refuse(absl::Status status, Done done) = 0;

 private:
  // Outlives the lease, while a commit is on its way.
  struct Progress {
    explicit Progress(uint64_t next) : next_pose_seq(next) {}
    std::mutex mutex;
    bool is_writing ABSL_GUARDED_BY(mutex) = false;
    uint64_t next_pose_seq ABSL_GUARDED_BY(mutex);  // after the last commit that ended OK
  };

  const uint64_t fencing_number_;
  const std::shared_ptr<Progress> progress_;
};

// What a store says that is no longer there.
absl::Status StoreClosedError();
// What a store says to a lease on a session that another has taken.
absl::Status FencedError(absl::string_view session, uint64_t fencing_number);
absl::Status SessionNotFoundError(absl::string_view session);
absl::Status SessionExistsError(absl::string_view session);
absl::Status ModelNotFoundError(absl::string_view model);

}  // namespace evpose::server
