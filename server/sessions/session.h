// SPDX-License-Identifier: Apache-2.0

// A session: a bounded queue of what its client sent, a strand that works it off, a log of the poses, and those who
// listen. No gRPC type is in here: server/rpc translates.
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/functional/any_invocable.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "absl/types/span.h"
#include "server/runtime/latency_histogram.h"
#include "server/runtime/worker_pool.h"
#include "server/sessions/durability/session_committer.h"
#include "server/sessions/session_pipeline.h"
#include "server/sessions/types/overload.h"
#include "server/sessions/types/pose_log.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"
#include "server/sessions/watched_session.h"
#include "server/telemetry/metrics.h"
#include "server/telemetry/session_log.h"

namespace evpose::server {

struct SessionLimits {
  uint64_t credit_bytes = 4ull << 20;  // undecoded bytes that may wait; at least max_chunk_bytes
  uint32_t max_chunk_bytes = 1u << 20;
  uint32_t pose_log_capacity = 16'384;        // poses that readers find
  absl::Duration expiry = absl::Minutes(10);  // without a stream
  // False: what is processed counts as durable, and is not written. For stores that end with the process.
  bool writes_checkpoints = true;
  SessionCommitter::Backoff backoff;
};

struct EventChunk {
  uint64_t seq = 0;
  bool discontinuity = false;
  std::optional<uint32_t> crc32c;
  std::string payload;
};

struct DecodeFault {
  uint64_t seq = 0;
  uint64_t count = 0;
  std::string detail;
};
struct StateChange {
  uint32_t object_index = 0;
  int64_t t_us = 0;
  TrackState state = TrackState::kInitializing;
};
// The state of the tracker could not be read when the session was taken up: every object is searched for again.
struct TrackingRestarted {
  uint64_t after_seq = 0;  // the last chunk that was tracked before
  std::string detail;      // why, for people
};
struct SessionNotice {
  uint64_t after_pose_seq = 0;  // its place among the poses
  std::variant<DecodeFault, StateChange, EventsDropped, TrackingRestarted> what;
};

struct SessionAck {
  uint64_t processed_seq = 0;
  uint64_t durable_seq = 0;
  uint64_t send_limit_bytes = 0;
  uint64_t last_pose_seq = 0;  // of the chunks up to processed_seq

  friend bool operator==(const SessionAck&, const SessionAck&) = default;
};

enum class SessionState { kDetached, kAttached, kEnded };

struct SessionSnapshot {
  SessionState state = SessionState::kDetached;
  absl::Status closed;  // not OK: the session is no more
  std::optional<absl::Time> expire_time;
  SessionHealth health;
};

struct SessionInfo {
  std::string name;
  SessionConfig config;
  absl::Time create_time;
  SessionSnapshot snapshot;
};

struct Attachment {
  uint64_t stream = 0;  // names this stream to the session
  uint64_t next_seq = 0;
  std::string resume_token;
  uint64_t send_limit_bytes = 0;
  uint64_t first_pose_seq = 0;
};

// What a stream must know to go on.
struct StreamView {
  absl::Status status;    // not OK: the stream is to end with it (fenced, deleted)
  bool has_room = false;  // another message may be pushed
  bool is_idle = false;   // everything pushed was processed, and its poses may be sent
  bool attached = false;  // the attachment is durable: it may be answered
  bool ended = false;     // `end` was processed, and all that came of it is durable
  SessionAck ack;
  uint64_t last_pose_seq = 0;  // that may be sent
};

// What a session begins with: nothing but its lifecycle, or where it stopped.
struct SessionBeginning {
  SessionLifecycle lifecycle;
  std::optional<SessionCheckpoint> checkpoint;
  std::vector<StoredPose> poses;  // in a row; may go on beyond the checkpoint
  std::optional<TrackingRestarted> restarted;
};

// As SessionLifecycle keeps it.
std::string TokenDigest(absl::string_view token);
bool IsDigestGood(absl::string_view digest, const SessionLifecycle& lifecycle);

class Session : public WatchedSession, public std::enable_shared_from_this<Session> {
 public:
  using SteadyTime = std::chrono::steady_clock::time_point;

  // A pose stream may be so far behind before the session waits for its reader (kBlock) or makes no more poses
  // (kLatest).
  static constexpr uint64_t kMaxUnsentPoses = 1024;
  // A watcher that is so far behind goes on with what is new.
  static constexpr uint64_t kMaxLivePosesBehind = 1024;
  // So many poses may wait for the store before the session does.
  static constexpr uint64_t kMaxUncommittedPoses = 4096;
  // A stream is sent no pose so far beyond the last one that the store has, whatever an item makes. So who attaches
  // after a crash cannot have seen more.
  static constexpr uint64_t kMaxPosesBeyondStore = 2 * kMaxUncommittedPoses;

  struct Parts {
    std::string name;
    std::string tenant;
    SessionConfig config;
    SessionLimits limits;
    std::vector<std::shared_ptr<const void>> model_uses;  // let go when the session closes
    std::unique_ptr<SessionPipeline> pipeline;  // in the state of the beginning's checkpoint; null when that is the end
    SessionBeginning beginning;
    std::unique_ptr<SessionLease> lease;
    std::string resume_token;  // that of the lifecycle, where it is known
    absl::Time create_time;
    absl::AnyInvocable<absl::Time() const> now;
    // For what is told of how long things took, and for max_lag.
    absl::AnyInvocable<SteadyTime() const> steady_now = std::chrono::steady_clock::now;
    std::shared_ptr<ServerMetrics> metrics = std::make_shared<ServerMetrics>();
  };
  static std::shared_ptr<Session> Start(Parts parts, WorkerPool& pool);
  ~Session() override;

  const std::string& name() const { return name_; }
  SessionLog& log() { return *log_; }
  const SessionConfig& config() const override { return config_; }
  const SessionLimits& limits() const { return limits_; }
  absl::Time create_time() const { return create_time_; }
  uint64_t fencing_number() const { return committer_->fencing_number(); }  // under which the store has it
  const PoseLog& pose_log() const { return pose_log_; }
  // Empty for a session that came from the store, until a stream attaches: the store does not know it.
  std::string resume_token() const;
  bool IsTokenGood(absl::string_view resume_token) const;
  SessionSnapshot Snapshot() const;
  void AddTo(SessionTotals& totals) const;
  SessionInfo Describe() const { return {name_, config_, create_time_, Snapshot()}; }
  std::optional<absl::Time> expire_time() const;  // absent while a stream is attached

  WatchView Watch() const override;
  std::vector<StoredPose> ReadPoses(uint64_t after_pose_seq, size_t max_poses) const override {
    return pose_log_.Read(after_pose_seq, max_poses);
  }
  uint64_t max_poses_behind() const override { return kMaxLivePosesBehind; }
  SessionHealth health() const override { return Snapshot().health; }
  void AddWatcher(std::weak_ptr<SessionListener> watcher) override { watchers_->Add(std::move(watcher)); }

  // The data plane; statuses and reasons are those that the API promises for Track.
  // Attaching fences the stream before: its view's status is ABORTED from now on. `peer` is for the log.
  absl::StatusOr<Attachment> Attach(absl::string_view resume_token, uint64_t last_pose_seq,
                                    std::weak_ptr<SessionListener> listener, const std::string& peer = "");
  void Detach(uint64_t stream);
  // Shows in the store that a server has the session, while a stream is attached: see OrphanSweep.
  void Renew();
  // Another token, which is durable when `done` is called; the one before stays good until the new one is used. Errors:
  // that with which the session has closed.
  void RenewToken(absl::AnyInvocable<void(absl::StatusOr<std::string>)> done);
  // Who pushes without room is not refused: memory stays bounded because a stream reads only when there is room.
  absl::Status PushEvents(uint64_t stream, EventChunk chunk);
  absl::Status PushResetPose(uint64_t stream, uint64_t seq, absl::string_view object_id,
                             const RigidTransform& camera_from_object);
  absl::Status PushEnd(uint64_t stream);
  StreamView View(uint64_t stream) const;
  std::vector<SessionNotice> TakeNotices(uint64_t stream);
  // The stream has sent the poses up to this one: the session may go on.
  void ReportSent(uint64_t stream, uint64_t pose_seq);

  // Ends everything with this status, which is not OK. The first one counts.
  void Close(const absl::Status& status);
  // Works no further than to the end of the item in work, and writes a checkpoint there.
  void Settle();
  // Nothing is left to be done or written after Settle, or the session is closed.
  bool IsSettled() const;

 private:
  Session(Parts parts, WorkerPool& pool);
  static uint64_t FirstPoseSeq(const SessionBeginning& beginning);
  static SessionCommitter::Progress DurableAtBeginning(const SessionBeginning& beginning);
  void TakeUp(SessionBeginning beginning) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  struct PoseReset {
    uint64_t seq = 0;
    uint32_t object_index = 0;
    RigidTransform camera_from_object;
  };
  struct End {};
  struct TokenRequest {
    uint64_t lifecycle = 0;
    std::string token;
    absl::AnyInvocable<void(absl::StatusOr<std::string>)> done;
  };
  struct Item {
    uint64_t stream = 0;
    SteadyTime received_at;
    std::variant<EventChunk, PoseReset, End> what;

    uint64_t bytes() const;
    uint64_t seq() const;  // 0 for the end, which has none
  };

  absl::Status CheckStream(uint64_t stream) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::Status CheckPush(uint64_t stream) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Whether the item with this number is the next one; false: it came already. Errors: SEQ_GAP, SESSION_ENDED.
  absl::StatusOr<bool> IsNext(uint64_t seq) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::Status CheckPayload(const EventChunk& chunk) const;
  void Enqueue(uint64_t stream, std::variant<EventChunk, PoseReset, End> what) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool IsRunnable() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool HasWork() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Schedule() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  uint64_t SendLimit() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  SessionAck MakeAck() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  Backlog MakeBacklog() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Without the lock; `stream_listener` may be null.
  void NotifyListeners(const std::shared_ptr<SessionListener>& stream_listener);
  int64_t MicrosecondsSince(SteadyTime begin) const;
  int64_t QueueAge_us() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // What has come since health_ was brought up to date (session_metrics.cc).
  void CountWork(const std::vector<StoredPose>& poses) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void ObservePipeline();
  void OnTransition(const PhaseTransition& transition) const;  // on the strand
  void LogWork(bool item_is_done) const;                       // on the strand

  // What is kept (session_checkpoint.cc).
  void ReplaceToken(std::string token, std::string previous_digest) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  SessionLifecycle MakeLifecycle() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool HasNews() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool IsCheckpointDue() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool MustWaitForStore() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  uint64_t LastPoseSeqToSend() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool IsEndDurable() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  uint64_t DurableSeq() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void CommitLifecycle();  // when it has changed
  void OnCommitProgress();
  void AnswerTokenRequests();

  // On the strand only.
  void Run();
  bool TakeItem();
  bool WriteDueCheckpoint();
  void WriteCheckpoint();
  uint64_t FirstPoseSeqKept() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool WorkOnItem();
  bool WorkOnEvents(const EventChunk& chunk);
  void SkipOrTrack(absl::Span<const uint8_t> slice);
  void Publish(bool item_is_done);
  std::vector<StoredPose> NumberPoses();
  std::optional<DecodeFault> FindDecodeFault() const;

  const std::string name_;
  const std::shared_ptr<SessionLog> log_;
  const SessionConfig config_;
  const SessionLimits limits_;
  const std::shared_ptr<SessionCommitter> committer_;
  PoseLog pose_log_;
  const absl::AnyInvocable<absl::Time() const> now_;
  const absl::AnyInvocable<SteadyTime() const> steady_now_;
  const std::shared_ptr<ServerMetrics> metrics_;
  const std::shared_ptr<Watchers> watchers_;
  const absl::Time create_time_;
  Strand strand_;

  // Of the strand.
  std::unique_ptr<SessionPipeline> pipeline_;
  PipelineOutput output_;
  std::optional<Item> item_;
  size_t item_offset_ = 0;
  DecodeCounts counts_before_item_;
  uint64_t next_pose_seq_ = 1;
  OverloadGate overload_;
  bool must_skip_ = false;                // the next slice
  EventGap skipped_;                      // of the slice, until it is published
  std::optional<EventsDropped> dropped_;  // before what is published next
  std::chrono::steady_clock::duration processing_time_{0};
  std::vector<float> explained_ratios_;
  std::vector<uint32_t> losses_before_;  // of the objects, before the tracker was made whose state was read

  mutable std::mutex mutex_;
  std::deque<Item> queue_ ABSL_GUARDED_BY(mutex_);
  uint64_t queued_bytes_ ABSL_GUARDED_BY(mutex_) = 0;                // the item in work included
  std::optional<SteadyTime> in_work_since_ ABSL_GUARDED_BY(mutex_);  // receipt of the item in work
  bool is_scheduled_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status closed_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::shared_ptr<const void>> model_uses_ ABSL_GUARDED_BY(mutex_);
  std::string resume_token_ ABSL_GUARDED_BY(mutex_);
  std::string token_digest_ ABSL_GUARDED_BY(mutex_);
  std::string previous_token_digest_ ABSL_GUARDED_BY(mutex_);  // empty: it is no longer good
  uint64_t num_renewals_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t lifecycle_number_ ABSL_GUARDED_BY(mutex_) = 0;     // of the newest lifecycle
  uint64_t committed_lifecycle_ ABSL_GUARDED_BY(mutex_) = 0;  // that was handed over
  uint64_t attach_lifecycle_ ABSL_GUARDED_BY(mutex_) = 0;     // that `attached` waits for
  std::vector<TokenRequest> token_requests_ ABSL_GUARDED_BY(mutex_);
  // As of the last checkpoint that was handed over.
  uint64_t checkpoint_seq_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t checkpoint_pose_seq_ ABSL_GUARDED_BY(mutex_) =
      0;  // of the store's log; ahead of health_.poses after a crash
  bool checkpoint_is_end_ ABSL_GUARDED_BY(mutex_) = false;
  int64_t checkpoint_processing_us_ ABSL_GUARDED_BY(mutex_) = 0;
  int64_t checkpoint_cost_us_ ABSL_GUARDED_BY(mutex_) = 0;
  bool is_settling_ ABSL_GUARDED_BY(mutex_) = false;
  // Its client may have seen poses up to here that are still to be made again; 0: it has seen none of those.
  uint64_t maybe_seen_pose_seq_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t stream_ ABSL_GUARDED_BY(mutex_) = 0;  // the latest; 0: none yet
  bool is_attached_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Time detached_at_ ABSL_GUARDED_BY(mutex_);
  uint64_t next_seq_ ABSL_GUARDED_BY(mutex_) = 1;
  uint64_t processed_seq_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t acked_pose_seq_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t consumed_bytes_ ABSL_GUARDED_BY(mutex_) = 0;  // of this stream: processed or ignored
  uint64_t received_bytes_ ABSL_GUARDED_BY(mutex_) = 0;  // of this stream: all
  uint64_t foreign_bytes_ ABSL_GUARDED_BY(mutex_) = 0;   // queued by earlier streams
  uint64_t sent_pose_seq_ ABSL_GUARDED_BY(mutex_) = 0;
  bool end_pushed_ ABSL_GUARDED_BY(mutex_) = false;
  bool ended_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<SessionNotice> notices_ ABSL_GUARDED_BY(mutex_);
  std::optional<TrackingRestarted> restarted_ ABSL_GUARDED_BY(mutex_);  // until a stream has taken the notice
  SessionHealth health_ ABSL_GUARDED_BY(mutex_);
  LatencyHistogram latencies_ ABSL_GUARDED_BY(mutex_);
  std::weak_ptr<SessionListener> stream_listener_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
