// SPDX-License-Identifier: Apache-2.0
#include "server/stores/common/checked_lease.h"

#include <utility>

#include "absl/strings/str_cat.h"

namespace evpose::server {
namespace {

// Checks that `poses` continue the log at `next_pose_seq`, and advances it beyond them.
absl::Status CheckContinues(const std::vector<PoseSegment>& poses, uint64_t& next_pose_seq) {
  for (const PoseSegment& segment : poses) {
    if (segment.first_pose_seq != next_pose_seq || segment.last_pose_seq < segment.first_pose_seq) {
      return absl::FailedPreconditionError(absl::StrCat("poses ", segment.first_pose_seq, " to ", segment.last_pose_seq,
                                                        " do not continue the log, which expects ", next_pose_seq));
    }
    next_pose_seq = segment.last_pose_seq + 1;
  }
  return absl::OkStatus();
}

}  // namespace

void CheckedLease::Commit(SessionCommit commit, Done done) {
  CommitPlace place;
  uint64_t next_pose_seq_after = 0;
  absl::Status refusal;
  {
    const std::lock_guard lock(progress_->mutex);
    place = progress_->next_place;
    next_pose_seq_after = place.next_pose_seq;
    refusal = progress_->is_writing ? absl::FailedPreconditionError("the last commit is not done yet")
                                    : CheckContinues(commit.poses, next_pose_seq_after);
    if (refusal.ok()) {
      progress_->is_writing = true;
      ++progress_->next_place.number;
    }
  }
  if (!refusal.ok()) return Refuse(std::move(refusal), std::move(done));
  Write(std::move(commit), place,
        [progress = progress_, number = place.number, next_pose_seq_after,
         done = std::move(done)](absl::Status status) mutable {
          {
            const std::lock_guard lock(progress->mutex);
            progress->is_writing = false;
            if (status.ok()) {
              progress->next_place.next_pose_seq = next_pose_seq_after;
              progress->next_place.last_ok = number;
            }
          }
          done(std::move(status));
        });
}

absl::Status StoreClosedError() { return absl::CancelledError("the store is closed"); }

absl::Status FencedError(absl::string_view session, uint64_t fencing_number) {
  return absl::AbortedError(absl::StrCat(session, " has been acquired again; lease ", fencing_number, " has ended"));
}

absl::Status RolledBackError(absl::string_view session, uint64_t fencing_number) {
  return absl::OutOfRangeError(absl::StrCat("the store has lost the last writes of ", session, ", which the lease ",
                                            fencing_number, " had made"));
}

absl::Status CheckHolder(absl::string_view session, const FencingToken& stored, const FencingToken& own) {
  if (stored == own) return absl::OkStatus();
  // Every later lease has a higher number. An earlier one holds the session again, or the same number was given twice.
  return stored.number < own.number ? RolledBackError(session, own.number) : FencedError(session, own.number);
}

absl::Status SessionNotFoundError(absl::string_view session) {
  return absl::NotFoundError(absl::StrCat("there is no session \"", session, "\" in the store"));
}

absl::Status SessionExistsError(absl::string_view session) {
  return absl::AlreadyExistsError(
      absl::StrCat("the store has a session \"", session, "\", or one of the same request_id, already"));
}

absl::Status RequestNotFoundError(absl::string_view request_id) {
  return absl::NotFoundError(absl::StrCat("no session of request_id \"", request_id, "\" is in the store"));
}

absl::Status ModelNotFoundError(absl::string_view model) {
  return absl::NotFoundError(absl::StrCat("there is no model \"", model, "\" in the store"));
}

}  // namespace evpose::server
