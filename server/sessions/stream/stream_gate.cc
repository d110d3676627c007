// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/stream/stream_gate.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"
#include "server/runtime/errors.h"
#include "server/runtime/random_name.h"

namespace evpose::server {

std::string TokenDigest(absl::string_view token) {
  return Sha256Hex({reinterpret_cast<const uint8_t*>(token.data()), token.size()});
}

bool IsDigestValid(absl::string_view digest, const SessionLifecycle& lifecycle) {
  const std::string& previous = lifecycle.previous_token_digest;
  return SecretsEqual(digest, lifecycle.token_digest) || (!previous.empty() && SecretsEqual(digest, previous));
}

absl::Status WrongToken(absl::string_view session) {
  return WithReason(absl::PermissionDeniedError(absl::StrCat("the resume token is not that of ", session,
                                                             "; each attach gives a new one: use the latest")),
                    v1::WRONG_TOKEN);
}

absl::Status ItemsLost(absl::string_view session, uint64_t lost_from_seq) {
  return WithReason(
      absl::DataLossError(absl::StrCat(
          "the store has lost the chunks of ", session, " from ", lost_from_seq,
          " on, and the client can no longer send them: the session has ended; its stored poses stay readable, and a "
          "new session can track the rest")),
      v1::ROLLED_BACK, {{"session", std::string(session)}, {"expected_seq", absl::StrCat(lost_from_seq)}});
}

StreamGate::StreamGate(Options options, Start start)
    : options_(std::move(options)),
      stream_(start.lifecycle.num_attaches),
      detached_at_(start.lifecycle.detached_at.value_or(start.detached_at)),
      resume_token_(std::move(start.resume_token)),
      token_digest_(std::move(start.lifecycle.token_digest)),
      previous_token_digest_(std::move(start.lifecycle.previous_token_digest)),
      num_renewals_(start.lifecycle.num_renewals),
      lost_from_seq_(start.lifecycle.lost_from_seq),
      next_seq_(start.processed_seq + 1),
      max_seen_pose_seq_(start.max_seen_pose_seq),
      credit_(options_.credit_bytes, options_.overload_policy) {
  if (start.has_ended) state_.input = InputState::kEnded;
  if (lost_from_seq_ > 0) closed_ = ItemsLost(options_.session, lost_from_seq_);
}

void StreamGate::ChangeState(GateEvent event) {
  const GateState from = std::exchange(state_, NextState(state_, event));
  if (state_ != from && options_.on_transition) options_.on_transition({from, state_, event});
}

std::optional<absl::Time> StreamGate::detached_at() const {
  if (is_attached()) return std::nullopt;
  return detached_at_;
}

SessionLifecycle StreamGate::lifecycle() const {
  return {.token_digest = token_digest_,
          .previous_token_digest = previous_token_digest_,
          .num_attaches = stream_,
          .detached_at = detached_at(),
          .num_renewals = num_renewals_,
          .lost_from_seq = lost_from_seq_};
}

std::optional<uint64_t> StreamGate::TakeChangedLifecycle() {
  if (taken_lifecycle_ == lifecycle_number_) return std::nullopt;
  taken_lifecycle_ = lifecycle_number_;
  return taken_lifecycle_;
}

absl::Status StreamGate::CheckAttach(absl::string_view token_digest, uint64_t last_pose_seq, uint64_t num_poses) const {
  EVPOSE_RETURN_IF_ERROR(closed_);
  if (!IsDigestValid(token_digest, lifecycle())) return WrongToken(options_.session);
  if (last_pose_seq > std::max(num_poses, max_seen_pose_seq_)) {
    return InvalidField("attach.last_pose_seq",
                        absl::StrCat("is ", last_pose_seq, ", but the session has made ", num_poses, " poses"));
  }
  return absl::OkStatus();
}

absl::Status StreamGate::CheckFirstSeq(absl::string_view token_digest, uint64_t first_seq) const {
  if (!closed_.ok() || has_ended() || first_seq <= next_seq_) return absl::OkStatus();
  if (!IsDigestValid(token_digest, lifecycle())) return absl::OkStatus();
  return ItemsLost(options_.session, next_seq_);
}

void StreamGate::RecordLoss() {
  lost_from_seq_ = next_seq_;
  ++lifecycle_number_;
}

uint64_t StreamGate::Attach(std::string new_token, std::string token_digest, uint64_t queued_bytes,
                            uint64_t sent_pose_seq) {
  ReplaceToken(std::move(new_token), std::move(token_digest));
  attach_lifecycle_ = lifecycle_number_;
  ++stream_;
  credit_.StartStream(queued_bytes);
  sent_pose_seq_ = sent_pose_seq;
  ChangeState(GateEvent::kAttach);
  return stream_;
}

bool StreamGate::Detach(uint64_t stream, absl::Time now) {
  if (stream != stream_ || !is_attached()) return false;
  detached_at_ = now;
  ++lifecycle_number_;
  ChangeState(GateEvent::kDetach);
  return true;
}

void StreamGate::OnLifecyclePersisted(uint64_t number) {
  if (number >= attach_lifecycle_) ChangeState(GateEvent::kAttachPersisted);
}

bool StreamGate::Close(const absl::Status& status) {
  if (!closed_.ok()) return false;
  closed_ = status;
  ChangeState(GateEvent::kClose);
  return true;
}

void StreamGate::ReplaceToken(std::string token, std::string previous_digest) {
  previous_token_digest_ = std::move(previous_digest);
  token_digest_ = TokenDigest(token);
  resume_token_ = std::move(token);
  ++lifecycle_number_;
}

bool StreamGate::RenewOwnership() {
  if (!is_attached()) return false;
  ++num_renewals_;
  ++lifecycle_number_;
  return true;
}

absl::Status StreamGate::CheckStream(uint64_t stream) const {
  EVPOSE_RETURN_IF_ERROR(closed_);
  if (stream == stream_) return absl::OkStatus();
  return WithReason(absl::AbortedError(absl::StrCat("another stream has attached to ", options_.session)), v1::FENCED);
}

absl::Status StreamGate::CheckPush(uint64_t stream) {
  EVPOSE_RETURN_IF_ERROR(CheckStream(stream));
  if (!previous_token_digest_.empty()) {
    previous_token_digest_.clear();
    ++lifecycle_number_;
  }
  return absl::OkStatus();
}

absl::StatusOr<bool> StreamGate::IsNext(uint64_t seq) const {
  if (seq < next_seq_) return false;
  if (state_.input != InputState::kOpen) {
    return WithReason(absl::FailedPreconditionError(
                          absl::StrCat(options_.session, " has ended: create a new session for further events")),
                      v1::SESSION_ENDED);
  }
  if (seq == next_seq_) return true;
  return WithReason(absl::FailedPreconditionError(absl::StrCat("chunk or reset ", seq, " was received, but ", next_seq_,
                                                               " is the next number: send the missing ones first")),
                    v1::SEQ_GAP, {{"expected_seq", absl::StrCat(next_seq_)}, {"seq", absl::StrCat(seq)}});
}

absl::StatusOr<bool> StreamGate::AcceptChunk(uint64_t seq, uint64_t bytes) {
  EVPOSE_ASSIGN_OR_RETURN(const bool is_next, IsNext(seq));
  credit_.AddReceived(bytes);
  if (is_next) {
    ++next_seq_;
  } else {
    credit_.AddProcessed(bytes, /*is_of_stream=*/true);
  }
  return is_next;
}

bool StreamGate::AcceptEnd() {
  if (state_.input != InputState::kOpen) return false;
  ChangeState(GateEvent::kEndPushed);
  return true;
}

}  // namespace evpose::server
