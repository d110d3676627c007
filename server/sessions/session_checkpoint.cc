// SPDX-License-Identifier: Apache-2.0

// What a session keeps, when it keeps it, and how it goes on from there.
#include <algorithm>
#include <iterator>
#include <mutex>
#include <utility>

#include "core/numerics/hash.h"
#include "server/runtime/random_name.h"
#include "server/sessions/durability/session_codec.h"
#include "server/sessions/session.h"

namespace evpose::server {
namespace {

// A checkpoint is due after so much work or so many poses, whichever comes first.
constexpr int64_t kCheckpointWorkUs = 100'000;
constexpr uint64_t kCheckpointPoses = 1000;
// And no sooner than after so many times the work that the last one was: it takes at most a twentieth of the time.
constexpr int64_t kCheckpointCostFactor = 20;

}  // namespace

std::string TokenDigest(absl::string_view token) {
  return Sha256Hex({reinterpret_cast<const uint8_t*>(token.data()), token.size()});
}

bool IsDigestGood(absl::string_view digest, const SessionLifecycle& lifecycle) {
  const std::string& previous = lifecycle.previous_token_digest;
  return SecretsEqual(digest, lifecycle.token_digest) || (!previous.empty() && SecretsEqual(digest, previous));
}

std::shared_ptr<Session> Session::Start(Parts parts, WorkerPool& pool) {
  const std::shared_ptr<Session> session(new Session(std::move(parts), pool));
  session->committer_->SetListener([weak = session->weak_from_this()] {
    if (const auto self = weak.lock()) self->OnCommitProgress();
  });
  return session;
}

uint64_t Session::FirstPoseSeq(const SessionBeginning& beginning) {
  if (!beginning.poses.empty()) return beginning.poses.front().pose_seq;
  return beginning.checkpoint.has_value() ? beginning.checkpoint->health.poses + 1 : 1;
}

SessionCommitter::Progress Session::DurableAtBeginning(const SessionBeginning& beginning) {
  SessionCommitter::Progress durable;
  if (beginning.checkpoint.has_value()) {
    durable.seq = beginning.checkpoint->processed_seq;
    durable.ended = beginning.checkpoint->ended;
  }
  if (!beginning.poses.empty()) durable.last_pose_seq = beginning.poses.back().pose_seq;
  return durable;
}

void Session::TakeUp(SessionBeginning beginning) {
  const SessionLifecycle& lifecycle = beginning.lifecycle;
  token_digest_ = lifecycle.token_digest;
  previous_token_digest_ = lifecycle.previous_token_digest;
  stream_ = lifecycle.num_attaches;
  num_renewals_ = lifecycle.num_renewals;
  // Who was attached lost the stream with the server: the session waits for it from now on.
  detached_at_ = lifecycle.detached_at.value_or(now_());
  if (beginning.checkpoint.has_value()) {
    health_ = std::move(beginning.checkpoint->health);
    latencies_ = beginning.checkpoint->latencies;
    processed_seq_ = beginning.checkpoint->processed_seq;
    ended_ = end_pushed_ = beginning.checkpoint->ended;
  }
  health_.received_bytes = health_.processed_bytes;
  health_.reattaches = static_cast<uint32_t>(stream_ > 0 ? stream_ - 1 : 0);
  next_seq_ = processed_seq_ + 1;
  acked_pose_seq_ = health_.poses;
  next_pose_seq_ = health_.poses + 1;
  processing_time_ = std::chrono::microseconds(health_.processing_us);
  losses_before_.assign(health_.objects.size(), 0);
  for (size_t i = 0; i < health_.objects.size(); ++i) {
    explained_ratios_[i] = health_.objects[i].explained_ratio;
    if (pipeline_ != nullptr) losses_before_[i] = health_.objects[i].losses - pipeline_->tracker().losses(i);
  }
  restarted_ = std::move(beginning.restarted);
  checkpoint_seq_ = processed_seq_;
  checkpoint_is_end_ = ended_;
  checkpoint_processing_us_ = health_.processing_us;
  checkpoint_pose_seq_ = std::max(health_.poses, pose_log_.last_pose_seq());
  const bool was_taken_up = resume_token_.empty();  // that of a new one is known
  if (was_taken_up) maybe_seen_pose_seq_ = checkpoint_pose_seq_ + kMaxPosesBeyondStore;
}

bool Session::IsTokenGood(absl::string_view resume_token) const {
  const std::string digest = TokenDigest(resume_token);
  const std::lock_guard lock(mutex_);
  return IsDigestGood(digest, MakeLifecycle());
}

void Session::ReplaceToken(std::string token, std::string previous_digest) {
  previous_token_digest_ = std::move(previous_digest);
  token_digest_ = TokenDigest(token);
  resume_token_ = std::move(token);
  ++lifecycle_number_;
}

void Session::RenewToken(absl::AnyInvocable<void(absl::StatusOr<std::string>)> done) {
  absl::StatusOr<std::string> token = RandomHex128();
  {
    const std::lock_guard lock(mutex_);
    if (token.ok() && !closed_.ok()) token = closed_;
    if (token.ok()) {
      ReplaceToken(*token, token_digest_);
      token_requests_.push_back({lifecycle_number_, *std::move(token), std::move(done)});
    }
  }
  if (!token.ok()) return done(token.status());
  CommitLifecycle();
}

void Session::AnswerTokenRequests() {
  std::vector<TokenRequest> answered;
  absl::Status closed;
  {
    const std::lock_guard lock(mutex_);
    closed = closed_;
    const uint64_t durable = committer_->progress().lifecycle;
    const auto waiting = std::stable_partition(
        token_requests_.begin(), token_requests_.end(),
        [&](const TokenRequest& request) { return !closed.ok() || request.lifecycle <= durable; });
    std::move(token_requests_.begin(), waiting, std::back_inserter(answered));
    token_requests_.erase(token_requests_.begin(), waiting);
  }
  for (TokenRequest& request : answered) {
    if (closed.ok()) {
      request.done(std::move(request.token));
    } else {
      request.done(closed);
    }
  }
}

SessionLifecycle Session::MakeLifecycle() const {
  SessionLifecycle lifecycle = {.token_digest = token_digest_,
                                .previous_token_digest = previous_token_digest_,
                                .num_attaches = stream_,
                                .num_renewals = num_renewals_};
  if (!is_attached_) lifecycle.detached_at = detached_at_;
  return lifecycle;
}

void Session::Renew() {
  {
    const std::lock_guard lock(mutex_);
    if (!is_attached_ || !closed_.ok()) return;
    ++num_renewals_;
    ++lifecycle_number_;
  }
  CommitLifecycle();
}

void Session::CommitLifecycle() {
  SessionLifecycle lifecycle;
  uint64_t number = 0;
  {
    const std::lock_guard lock(mutex_);
    if (committed_lifecycle_ == lifecycle_number_ || !closed_.ok()) return;
    number = committed_lifecycle_ = lifecycle_number_;
    lifecycle = MakeLifecycle();
  }
  committer_->CommitLifecycle(number, EncodeLifecycle(lifecycle));
}

uint64_t Session::DurableSeq() const {
  return limits_.writes_checkpoints ? committer_->progress().seq : processed_seq_;
}

bool Session::IsEndDurable() const { return ended_ && (!limits_.writes_checkpoints || committer_->progress().ended); }

bool Session::HasNews() const { return processed_seq_ != checkpoint_seq_ || ended_ != checkpoint_is_end_; }

bool Session::IsCheckpointDue() const {
  if (!limits_.writes_checkpoints || committer_->progress().has_waiting) return false;
  const uint64_t new_poses = health_.poses - std::min(health_.poses, checkpoint_pose_seq_);
  // An item may make more poses than may wait: those go alone.
  if (in_work_since_.has_value()) return new_poses >= kMaxUncommittedPoses;
  if (!HasNews()) return false;
  if (ended_ || is_settling_ || (!is_attached_ && queue_.empty())) return true;
  if (new_poses >= kMaxUncommittedPoses) return true;
  const int64_t work_us = health_.processing_us - checkpoint_processing_us_;
  if (work_us < kCheckpointCostFactor * checkpoint_cost_us_) return false;
  return work_us >= kCheckpointWorkUs || new_poses >= kCheckpointPoses;
}

bool Session::MustWaitForStore() const {
  if (!limits_.writes_checkpoints) return false;
  const uint64_t durable = committer_->progress().last_pose_seq;
  return health_.poses >= durable + kMaxUncommittedPoses;
}

uint64_t Session::LastPoseSeqToSend() const {
  if (!limits_.writes_checkpoints) return health_.poses;
  return std::min(health_.poses, committer_->progress().last_pose_seq + kMaxPosesBeyondStore);
}

// The poses that wait for the store stay in the log, and with kBlock those that wait for their reader: a slice may make
// more of them than the log holds.
uint64_t Session::FirstPoseSeqKept() const {
  uint64_t first = UINT64_MAX;
  if (limits_.writes_checkpoints) first = checkpoint_pose_seq_ + 1;
  if (is_attached_ && config_.overload_policy == OverloadPolicy::kBlock) first = std::min(first, sent_pose_seq_ + 1);
  return first;
}

bool Session::WriteDueCheckpoint() {
  {
    const std::lock_guard lock(mutex_);
    if (!closed_.ok() || !IsCheckpointDue()) return false;
  }
  WriteCheckpoint();
  const std::lock_guard lock(mutex_);
  is_scheduled_ = false;
  Schedule();
  return true;
}

void Session::WriteCheckpoint() {
  const auto begin = std::chrono::steady_clock::now();
  SessionCommitter::Checkpoint out = {.begun_at = begin};
  SessionCheckpoint state;
  bool is_whole = false;
  uint64_t after_pose_seq = 0;
  {
    const std::lock_guard lock(mutex_);
    is_whole = !in_work_since_.has_value();
    after_pose_seq = checkpoint_pose_seq_;
    state = {.processed_seq = processed_seq_, .ended = ended_, .health = health_, .latencies = latencies_};
    if (ended_) out.ended_at = now_();
  }
  state.health.received_bytes = state.health.processed_bytes;
  const std::vector<StoredPose> poses = pose_log_.Read(after_pose_seq, SIZE_MAX);
  if (!poses.empty()) out.poses = EncodePoses(poses);
  out.first_pose_seq_kept = pose_log_.first_pose_seq();
  if (is_whole) {
    if (pipeline_ != nullptr) state.pipeline = pipeline_->SaveState();
    out.state = EncodeCheckpoint(state);
    out.seq = state.processed_seq;
  }
  const int64_t cost_us =
      std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now() - begin).count();
  {
    const std::lock_guard lock(mutex_);
    checkpoint_pose_seq_ = std::max(after_pose_seq, pose_log_.last_pose_seq());
    if (is_whole) {
      checkpoint_seq_ = state.processed_seq;
      checkpoint_is_end_ = state.ended;
      checkpoint_processing_us_ = state.health.processing_us;
      checkpoint_cost_us_ = cost_us;
    }
  }
  committer_->CommitCheckpoint(std::move(out));
}

void Session::OnCommitProgress() {
  const absl::Status failure = committer_->progress().failure;
  if (!failure.ok()) Close(failure);
  std::shared_ptr<SessionListener> stream_listener;
  {
    const std::lock_guard lock(mutex_);
    Schedule();
    stream_listener = stream_listener_.lock();
  }
  AnswerTokenRequests();
  NotifyListeners(stream_listener);
}

void Session::Settle() {
  const std::lock_guard lock(mutex_);
  is_settling_ = true;
  Schedule();
}

bool Session::IsSettled() const {
  const std::lock_guard lock(mutex_);
  if (!closed_.ok()) return true;
  const SessionCommitter::Progress progress = committer_->progress();
  if (in_work_since_.has_value() || progress.lifecycle < lifecycle_number_) return false;
  return !limits_.writes_checkpoints || (!HasNews() && !progress.has_waiting);
}

}  // namespace evpose::server
