// SPDX-License-Identifier: Apache-2.0

// The part of Session that writes its state to the store: checkpoints, ownership and tokens.
#include <algorithm>
#include <utility>

#include "core/base/yield_point.h"
#include "server/runtime/random_name.h"
#include "server/sessions/durability/pose_codec.h"
#include "server/sessions/durability/session_codec.h"
#include "server/sessions/session.h"

namespace evpose::server {

bool Session::WriteDueCheckpoint() {
  {
    const std::lock_guard lock(mutex_);
    if (!gate_.closed().ok() || !checkpoints_.IsDue(MakeCounters(), committer_->progress())) return false;
  }
  WriteCheckpoint();
  const std::lock_guard lock(mutex_);
  is_scheduled_ = false;
  Schedule();
  return true;
}

void Session::WriteCheckpoint() {
  const auto begin = std::chrono::steady_clock::now();
  const auto paused_before = PausedTime();
  SessionCommit out;
  SessionCheckpoint state;
  bool is_whole = false;  // between two items; otherwise only the poses are written
  uint64_t after_pose_seq = 0;
  {
    const std::lock_guard lock(mutex_);
    is_whole = !queue_.is_working();
    after_pose_seq = checkpoints_.last_pose_seq();
    state = {.processed_seq = report_.processed_seq(),
             .ended = gate_.has_ended(),
             .health = report_.health(),
             .latencies = report_.latencies()};
    if (state.ended) out.ended_at = clocks_.wall();
  }
  state.health.received_bytes = state.health.processed_bytes;
  const std::vector<StoredPose> poses = pose_log_.Read(after_pose_seq, SIZE_MAX);
  if (!poses.empty()) out.poses.push_back(EncodePoses(poses));
  out.first_pose_seq_kept = pose_log_.first_pose_seq();
  if (is_whole) {
    if (worker_.has_pipeline()) state.pipeline = worker_.SaveState();
    out.checkpoint = EncodeCheckpoint(state);
  }
  const int64_t cost_us = std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now() -
                                                                                begin - (PausedTime() - paused_before))
                              .count();
  {
    const std::lock_guard lock(mutex_);
    checkpoints_.RecordPoses(std::max(after_pose_seq, pose_log_.last_pose_seq()));
    if (is_whole)
      checkpoints_.RecordCheckpoint({state.processed_seq, state.ended, state.health.processing_us, cost_us});
  }
  committer_->CommitCheckpoint(std::move(out), state.processed_seq, begin);
}

void Session::RenewOwnership() {
  {
    const std::lock_guard lock(mutex_);
    if (!gate_.RenewOwnership()) return;
  }
  CommitLifecycle();
}

void Session::RenewToken(absl::AnyInvocable<void(absl::StatusOr<std::string>)> done) {
  absl::StatusOr<std::string> token = RandomHex128();
  {
    std::unique_lock lock(mutex_);
    if (token.ok() && !gate_.closed().ok()) token = gate_.closed();
    if (!token.ok()) {
      lock.unlock();
      return done(token.status());
    }
    gate_.ReplaceToken(*token);
    token_requests_.Add({gate_.lifecycle_number(), *std::move(token), std::move(done)});
  }
  CommitLifecycle();
}

void Session::AnswerTokenRequests() {
  std::vector<TokenRequest> answerable;
  absl::Status closed;
  {
    const std::lock_guard lock(mutex_);
    closed = gate_.closed();
    answerable = token_requests_.TakeAnswerable(committer_->progress().lifecycle, !closed.ok());
  }
  for (TokenRequest& request : answerable) {
    if (closed.ok()) {
      request.done(std::move(request.token));
    } else {
      request.done(closed);
    }
  }
}

void Session::CommitLifecycle() {
  SessionLifecycle lifecycle;
  std::optional<uint64_t> number;
  {
    const std::lock_guard lock(mutex_);
    if (!gate_.closed().ok()) return;
    number = gate_.TakeChangedLifecycle();
    if (!number.has_value()) return;
    lifecycle = gate_.lifecycle();
  }
  committer_->CommitLifecycle(*number, EncodeLifecycle(lifecycle));
}

void Session::OnCommitProgress() {
  const absl::Status failure = committer_->progress().failure;
  if (!failure.ok()) Close(failure);
  std::shared_ptr<SessionListener> stream_listener;
  {
    const std::lock_guard lock(mutex_);
    gate_.OnLifecyclePersisted(committer_->progress().lifecycle);
    Schedule();
    stream_listener = stream_listener_.lock();
  }
  AnswerTokenRequests();
  NotifyListeners(stream_listener);
}

void Session::Flush() {
  const std::lock_guard lock(mutex_);
  checkpoints_.RequestFlush();
  Schedule();
}

bool Session::IsFlushed() const {
  const std::lock_guard lock(mutex_);
  if (!gate_.closed().ok()) return true;
  const SessionCommitter::Progress progress = committer_->progress();
  return progress.lifecycle >= gate_.lifecycle_number() && checkpoints_.IsFlushed(MakeCounters(), progress);
}

}  // namespace evpose::server
