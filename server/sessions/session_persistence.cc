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
namespace {

// Does the same as PoseLog::Read() without a limit, with yield points: thousands of poses may wait, and Read() copies
// them with the lock of the log. Only turns of the session append to the log.
std::vector<StoredPose> ReadPosesInPages(const PoseLog& log, uint64_t after_pose_seq) {
  constexpr size_t kPosesPerPage = 64;  // some 50 KB
  std::vector<StoredPose> poses;
  const uint64_t last = log.last_pose_seq();
  if (last > after_pose_seq) poses.reserve(last - std::max(after_pose_seq, log.first_pose_seq() - 1));
  while (true) {
    const std::vector<StoredPose> page =
        log.Read(poses.empty() ? after_pose_seq : poses.back().pose_seq, kPosesPerPage);
    if (page.empty()) return poses;
    poses.insert(poses.end(), page.begin(), page.end());
    YieldPoint();
  }
}

}  // namespace

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
             .has_ended = gate_.has_ended(),
             .health = report_.health(),
             .latencies = report_.latencies()};
    if (state.has_ended) out.ended_at = clocks_.wall();
  }
  state.health.received_bytes = state.health.processed_bytes;
  // There are yield points up to CommitCheckpoint(): no lock is held, and other calls of the session may come between.
  const std::vector<StoredPose> poses = ReadPosesInPages(pose_log_, after_pose_seq);
  AddPoses(poses, out);
  if (is_whole) {
    SessionCheckpoint whole = state;
    if (worker_.has_pipeline()) whole.pipeline = worker_.SaveState();
    out.checkpoint = EncodeCheckpoint(std::move(whole));
  }
  const int64_t cost_us = std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now() -
                                                                                begin - (PausedTime() - paused_before))
                              .count();
  {
    const std::lock_guard lock(mutex_);
    checkpoints_.RecordPoses(std::max(after_pose_seq, pose_log_.last_pose_seq()));
    if (is_whole)
      checkpoints_.RecordCheckpoint({state.processed_seq, state.has_ended, state.health.processing_us, cost_us});
  }
  committer_->CommitCheckpoint(std::move(out), state.processed_seq, begin);
}

void Session::AddPoses(absl::Span<const StoredPose> poses, SessionCommit& out) {
  if (!poses.empty()) {
    out.poses.push_back(EncodePoses(poses));
    stored_segments_.Add(out.poses.back());
  }
  {
    const std::lock_guard lock(mutex_);
    pose_log_.RemoveBefore(std::min(stored_segments_.FirstPoseSeqToKeep(), FirstPoseSeqToKeep()));
  }
  out.first_pose_seq_kept = pose_log_.first_pose_seq();
  stored_segments_.RemoveBefore(out.first_pose_seq_kept);
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
    answerable = token_requests_.RemoveAnswerable(committer_->progress().lifecycle, !closed.ok());
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
