// SPDX-License-Identifier: Apache-2.0

// Decides which stream may write to a session, and which of its items is the next one.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "server/sessions/stream/byte_credit.h"
#include "server/sessions/stream/gate_state.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"

namespace evpose::server {

// Returns the SHA-256 of a resume token in hexadecimal digits, as SessionLifecycle stores it.
std::string TokenDigest(absl::string_view token);
// Returns true for the digest of the current token, and for that of the previous token while it is still valid.
bool IsDigestValid(absl::string_view digest, const SessionLifecycle& lifecycle);

// Returns the error PERMISSION_DENIED (WRONG_TOKEN).
absl::Status WrongToken(absl::string_view session);

// Returns the error DATA_LOSS (ROLLED_BACK) of a session with SessionLifecycle::lost_from_seq.
absl::Status ItemsLost(absl::string_view session, uint64_t lost_from_seq);

// Not thread-safe; uses no lock, thread or clock. Streams are numbered from 1. The number serves as a fence: only the
// latest stream may write. The lifecycle record (SessionLifecycle) has a number of its own, which grows with each
// change.
class StreamGate {
 public:
  struct Options {
    std::string session;
    uint64_t credit_bytes = 0;
    OverloadPolicy overload_policy = OverloadPolicy::kBlock;
    std::function<void(const GateTransition&)> on_transition;  // for the log; may be null
  };
  struct Start {
    SessionLifecycle lifecycle;
    absl::Time detached_at;          // used if a stream is attached according to the record: its server has ended
    std::string resume_token;        // empty: unknown, because the store has only its digest
    uint64_t processed_seq = 0;      // number of the last chunk in the checkpoint
    bool has_ended = false;          // whether the checkpoint includes the end of the session
    uint64_t max_seen_pose_seq = 0;  // the client may have seen poses up to this one that are not made again yet
  };
  StreamGate(Options options, Start start);

  const GateState& state() const { return state_; }
  bool is_attached() const {
    return state_.writer == WriterState::kAttaching || state_.writer == WriterState::kAttached;
  }
  bool has_ended() const { return state_.input == InputState::kEnded; }
  // OK until Close(), unless the gate starts with SessionLifecycle::lost_from_seq.
  const absl::Status& closed() const { return closed_; }
  uint64_t stream() const { return stream_; }  // the latest; 0: none yet
  // Returns the time since when no stream has been attached; absent while one is attached.
  std::optional<absl::Time> detached_at() const;
  const std::string& resume_token() const { return resume_token_; }
  SessionLifecycle lifecycle() const;
  uint64_t lifecycle_number() const { return lifecycle_number_; }
  // Returns the number of the record if it has changed since the last call and has to be committed.
  std::optional<uint64_t> TakeChangedLifecycle();

  // Errors: the status of Close; PERMISSION_DENIED (WRONG_TOKEN); INVALID_ARGUMENT if the client states a last received
  // pose that the session, which has made `num_poses`, cannot have sent.
  absl::Status CheckAttach(absl::string_view token_digest, uint64_t last_pose_seq, uint64_t num_poses) const;
  // Errors: DATA_LOSS (ROLLED_BACK) if the session is open and expects an item before `first_seq`, the first one that
  // the client can still send (0: unknown). A wrong token and a closed session are left to CheckAttach.
  absl::Status CheckFirstSeq(absl::string_view token_digest, uint64_t first_seq) const;
  // Records that the items from next_seq() on are lost. The gate is to be closed when that has been committed.
  void RecordLoss();
  // To be called after CheckAttach(). Fences the previous stream. `queued_bytes` are those of earlier streams. The
  // token with `token_digest` stays valid until the stream sends its first item. Returns the number of the stream.
  uint64_t Attach(std::string new_token, std::string token_digest, uint64_t queued_bytes, uint64_t sent_pose_seq);
  // Returns false if this stream is not attached.
  bool Detach(uint64_t stream, absl::Time now);
  // The client of the stream sends no more items. Without effect unless the stream is the latest one.
  void HalfClose(uint64_t stream) {
    if (stream == stream_) half_closed_stream_ = stream;
  }
  // Whether a stream is attached whose client has not half-closed it.
  bool may_receive() const { return is_attached() && half_closed_stream_ != stream_; }
  // Reports that the store has the lifecycle record with this number and all before.
  void OnLifecyclePersisted(uint64_t number);
  // Closes the gate with `status`, which is not OK. Returns true for the first call; later calls have no effect and
  // return false.
  bool Close(const absl::Status& status);

  // Sets a new token. The current one stays valid as in Attach().
  void ReplaceToken(std::string token) { ReplaceToken(std::move(token), token_digest_); }
  // Changes the lifecycle record to show that this server is alive. Returns false if no stream is attached.
  bool RenewOwnership();

  // Errors: the status of Close, ABORTED (FENCED).
  absl::Status CheckStream(uint64_t stream) const;
  // To be called before each item of a stream, which shows that the client has the new token: the previous one is no
  // longer valid. Errors: as CheckStream.
  absl::Status CheckPush(uint64_t stream);
  // Returns true if `seq` is the next item, false if the session has had it. Errors: FAILED_PRECONDITION (SEQ_GAP,
  // SESSION_ENDED).
  absl::StatusOr<bool> IsNext(uint64_t seq) const;
  void Accept() { ++next_seq_; }  // the item with next_seq
  // Returns IsNext(); accepts the chunk when it is the next item, and counts its bytes in both cases.
  absl::StatusOr<bool> AcceptChunk(uint64_t seq, uint64_t bytes);
  // Returns false if the end was pushed before.
  bool AcceptEnd();
  void OnProcessed(uint64_t stream, uint64_t bytes) { credit_.AddProcessed(bytes, stream == stream_); }
  void OnEndProcessed() { ChangeState(GateEvent::kEndProcessed); }

  uint64_t next_seq() const { return next_seq_; }
  uint64_t SendLimit() const { return credit_.SendLimit(); }
  // Highest number of a pose that the stream has sent to its client.
  uint64_t sent_pose_seq() const { return sent_pose_seq_; }
  void ReportSent(uint64_t pose_seq) { sent_pose_seq_ = pose_seq; }

 private:
  void ReplaceToken(std::string token, std::string previous_digest);
  void ChangeState(GateEvent event);  // the only function that changes state_ after construction

  const Options options_;
  GateState state_;
  absl::Status closed_;
  uint64_t stream_ = 0;
  uint64_t half_closed_stream_ = 0;  // the latest that its client has half-closed; 0: none
  absl::Time detached_at_;           // time of the last detachment
  std::string resume_token_;
  std::string token_digest_;
  std::string previous_token_digest_;  // empty: no longer valid
  uint64_t num_renewals_ = 0;
  uint64_t lost_from_seq_ = 0;
  uint64_t lifecycle_number_ = 0;
  uint64_t taken_lifecycle_ = 0;   // number of the record that TakeChangedLifecycle returned last
  uint64_t attach_lifecycle_ = 0;  // the number of the record with which the latest stream attached
  uint64_t next_seq_ = 1;
  uint64_t sent_pose_seq_ = 0;
  uint64_t max_seen_pose_seq_ = 0;
  ByteCredit credit_;
};

}  // namespace evpose::server
