// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/session_committer.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {
namespace {

// Ten times the period of checkpoints: the client then keeps ten times as many chunks as usual.
constexpr std::chrono::seconds kSlowCommit{1};

}  // namespace

SessionCommitter::SessionCommitter(std::shared_ptr<const SessionLog> log, std::unique_ptr<SessionLease> lease,
                                   const Progress& persisted, WorkerPool& pool, const Backoff& backoff,
                                   std::shared_ptr<ServerMetrics> metrics)
    : log_(std::move(log)),
      lease_(std::move(lease)),
      pool_(pool),
      backoff_(backoff),
      metrics_(std::move(metrics)),
      progress_(persisted),
      newest_lifecycle_(persisted.lifecycle),
      retry_after_(backoff.first) {}

void SessionCommitter::Batch::Append(Batch later) {
  if (later.commit.lifecycle.has_value()) {
    commit.lifecycle = std::move(later.commit.lifecycle);
    lifecycle = later.lifecycle;
  }
  if (later.commit.checkpoint.has_value()) {
    commit.checkpoint = std::move(later.commit.checkpoint);
    seq = later.seq;
  }
  for (PoseSegment& segment : later.commit.poses) commit.poses.push_back(std::move(segment));
  commit.first_pose_seq_kept = std::max(commit.first_pose_seq_kept, later.commit.first_pose_seq_kept);
  if (later.commit.ended_at.has_value()) commit.ended_at = later.commit.ended_at;
  last_pose_seq = std::max(last_pose_seq, later.last_pose_seq);
  if (!has_checkpoint) begun_at = later.begun_at;
  has_checkpoint |= later.has_checkpoint;
}

void SessionCommitter::CommitLifecycle(uint64_t number, std::string lifecycle) {
  {
    const std::lock_guard lock(mutex_);
    if (state_ == State::kFinishing || number <= newest_lifecycle_) return;
    newest_lifecycle_ = number;
    waiting_.Append({.commit = {.lifecycle = std::move(lifecycle)}, .lifecycle = number});
  }
  StartCommit();
}

void SessionCommitter::CommitCheckpoint(SessionCommit checkpoint, uint64_t seq,
                                        std::chrono::steady_clock::time_point begun_at) {
  {
    const std::lock_guard lock(mutex_);
    if (state_ == State::kFinishing) return;
    const uint64_t last_pose_seq = checkpoint.poses.empty() ? 0 : checkpoint.poses.back().last_pose_seq;
    waiting_.Append({.commit = std::move(checkpoint),
                     .seq = seq,
                     .last_pose_seq = last_pose_seq,
                     .has_checkpoint = true,
                     .begun_at = begun_at});
  }
  StartCommit();
}

SessionCommitter::Progress SessionCommitter::progress() const {
  const std::lock_guard lock(mutex_);
  Progress progress = progress_;
  progress.has_waiting = waiting_.has_checkpoint || in_flight_.has_checkpoint;
  return progress;
}

void SessionCommitter::Finish() {
  const std::lock_guard lock(mutex_);
  if (state_ == State::kOpen) state_ = State::kFinishing;
}

void SessionCommitter::Close() {
  const std::lock_guard lock(mutex_);
  if (state_ == State::kFinishing) return;
  state_ = State::kClosed;
  waiting_ = Batch();
  timer_.reset();
}

void SessionCommitter::StartCommit() {
  SessionCommit commit;
  {
    const std::lock_guard lock(mutex_);
    // While the store is unreachable, later records are added to the commit that is repeated.
    if (state_ == State::kClosed || is_in_flight_ || timer_ != nullptr) return;
    in_flight_.Append(std::exchange(waiting_, Batch()));
    if (in_flight_.is_empty()) return;
    commit = in_flight_.commit;  // first, because it may throw: the next call then tries again
    is_in_flight_ = true;
  }
  lease_->Commit(std::move(commit), [self = shared_from_this()](const absl::Status& status) { self->OnDone(status); });
}

void SessionCommitter::ContinueCommits() {
  const absl::Status status = OrOutOfMemory([this] { return StartCommit(), absl::OkStatus(); });
  if (status.ok()) return;
  EndOutOfMemory(status);
  if (listener_ != nullptr) listener_();
}

void SessionCommitter::OnDone(const absl::Status& status) {
  const absl::Status recorded = OrOutOfMemory([&] { return Record(status), absl::OkStatus(); });
  if (!recorded.ok()) EndOutOfMemory(recorded);
  if (listener_ != nullptr) listener_();
  ContinueCommits();
}

void SessionCommitter::EndOutOfMemory(const absl::Status& status) {
  const std::lock_guard lock(mutex_);
  state_ = State::kClosed;
  progress_.failure.Update(status);
}

void SessionCommitter::Record(const absl::Status& status) {
  const std::lock_guard lock(mutex_);
  is_in_flight_ = false;
  CountFailure(status);
  if (status.ok()) {
    RecordDone();
  } else if (absl::IsUnavailable(status)) {
    if (!progress_.is_store_unavailable) log_->StoreUnavailable(status);
    progress_.is_store_unavailable = true;
    RetryLater();
  } else if (progress_.failure.ok()) {
    progress_.failure = FailureOf(status);
    if (state_ != State::kClosed) log_->CommitFailed(progress_.failure);
    state_ = State::kClosed;
  }
}

void SessionCommitter::CountBytes() {
  const SessionCommit& commit = in_flight_.commit;
  OneFor<CommitPart, 3>& bytes = metrics_->commit_bytes;
  if (commit.checkpoint.has_value()) bytes[CommitPart::kCheckpoint].Add(commit.checkpoint->size());
  if (commit.lifecycle.has_value()) bytes[CommitPart::kLifecycle].Add(commit.lifecycle->size());
  bytes[CommitPart::kPoses].Add(SizeBytes(commit.poses));
}

void SessionCommitter::RecordDone() {
  CountBytes();
  if (in_flight_.has_checkpoint) RecordDuration();
  if (progress_.is_store_unavailable) RunUnlessOutOfMemory([this] { log_->StoreBack(); });
  progress_.is_store_unavailable = false;
  retry_after_ = backoff_.first;
  progress_.lifecycle = std::max(progress_.lifecycle, in_flight_.lifecycle);
  progress_.seq = std::max(progress_.seq, in_flight_.seq);
  progress_.last_pose_seq = std::max(progress_.last_pose_seq, in_flight_.last_pose_seq);
  progress_.has_ended |= in_flight_.commit.ended_at.has_value();
  in_flight_ = Batch();
}

void SessionCommitter::RecordDuration() {
  const auto duration = std::chrono::steady_clock::now() - in_flight_.begun_at;
  metrics_->checkpoint_time.Add(duration, log_->trace_id());
  const bool was_slow = std::exchange(is_slow_, duration >= kSlowCommit);
  // An outage is logged as session_waits_for_store.
  if (!is_slow_ || was_slow || progress_.is_store_unavailable) return;
  const SessionCommit& commit = in_flight_.commit;
  const uint64_t bytes = (commit.checkpoint.has_value() ? commit.checkpoint->size() : 0) + SizeBytes(commit.poses);
  RunUnlessOutOfMemory([&] { log_->CommitSlow(absl::FromChrono(duration), bytes); });
}

void SessionCommitter::RetryLater() {
  if (state_ == State::kClosed) return;
  timer_ = pool_.PostAfter(retry_after_, [weak = weak_from_this()] {
    const auto self = weak.lock();
    if (self == nullptr) return;
    {
      const std::lock_guard lock(self->mutex_);
      self->timer_.reset();
    }
    self->ContinueCommits();
  });
  retry_after_ = std::min(2 * retry_after_, backoff_.longest);
}

void SessionCommitter::CountFailure(const absl::Status& status) {
  // NOT_FOUND: the session was deleted. CANCELLED: the server is shutting down.
  const bool is_failure = !status.ok() && !absl::IsNotFound(status) && !absl::IsCancelled(status);
  if (!is_failure || !in_flight_.has_checkpoint) return;
  const CheckpointFailure kind = absl::IsUnavailable(status)         ? CheckpointFailure::kStoreUnavailable
                                 : absl::IsResourceExhausted(status) ? CheckpointFailure::kStoreFull
                                 : absl::IsAborted(status)           ? CheckpointFailure::kFenced
                                 : absl::IsOutOfRange(status)        ? CheckpointFailure::kRolledBack
                                                                     : CheckpointFailure::kStoreFailed;
  metrics_->checkpoint_failures[kind].Add();
}

absl::Status SessionCommitter::FailureOf(const absl::Status& status) const {
  const std::string& session = log_->session();
  switch (status.code()) {
    case absl::StatusCode::kAborted:
      return WithReason(absl::AbortedError(absl::StrCat("another server has taken ", session)), v1::FENCED);
    case absl::StatusCode::kNotFound:
      return WithReason(absl::NotFoundError(absl::StrCat(session, " was deleted")), v1::SESSION_DELETED,
                        {{"session", session}});
    case absl::StatusCode::kOutOfRange:
      // UNAVAILABLE, so that the client attaches again: the session is then resumed from what the store has.
      return WithReason(absl::UnavailableError(absl::StrCat(
                            "the store has lost the last changes of ", session,
                            ", because a replica without them was made its master; attach again to continue")),
                        v1::ROLLED_BACK, {{"session", session}});
    case absl::StatusCode::kResourceExhausted:
      return WithReason(absl::ResourceExhaustedError(
                            absl::StrCat("the store has no room for ", session, ": ", status.message(),
                                         "; the data acknowledged as durable are kept: make room, then attach again")),
                        v1::STORE_FULL);
    case absl::StatusCode::kCancelled:
      return WithReason(
          absl::UnavailableError("the server shuts down: attach again, at another server if there is one"),
          v1::DRAINING);
    default:
      return WithReason(
          absl::InternalError(absl::StrCat("the store could not write ", session, ": ", status.message())),
          v1::STORE_FAILED);
  }
}

}  // namespace evpose::server
