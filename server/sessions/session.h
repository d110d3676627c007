// SPDX-License-Identifier: Apache-2.0

// One session: the composition of its parts (README.md), their lock and their turns.
#pragma once

#include <cstdint>
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
#include "server/runtime/worker_pool.h"
#include "server/scheduling/arrival_monitor.h"
#include "server/scheduling/pace_monitor.h"
#include "server/sessions/durability/checkpoint_policy.h"
#include "server/sessions/durability/segment_sizes.h"
#include "server/sessions/durability/session_committer.h"
#include "server/sessions/session_limits.h"
#include "server/sessions/session_parts.h"
#include "server/sessions/session_pipeline.h"
#include "server/sessions/session_report.h"
#include "server/sessions/session_worker.h"
#include "server/sessions/stream/stream_gate.h"
#include "server/sessions/stream/token_requests.h"
#include "server/sessions/stream/work_queue.h"
#include "server/sessions/types/pose_log.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"
#include "server/sessions/types/stream_data.h"
#include "server/sessions/watching/watched_session.h"
#include "server/telemetry/metrics.h"
#include "server/telemetry/session_log.h"

namespace evpose::server {

// Thread-safe.
class Session : public WatchedSession, public std::enable_shared_from_this<Session> {
 public:
  static std::shared_ptr<Session> Start(SessionParts parts, WorkerPool& pool);
  ~Session() override;

  const std::string& name() const { return log_->session(); }
  SessionLog& log() { return *log_; }
  const SessionConfig& config() const override { return config_; }
  const SessionLimits& limits() const { return limits_; }
  absl::Time create_time() const { return create_time_; }
  const FencingToken& token() const { return committer_->token(); }  // of the session's lease in the store
  const PoseLog& pose_log() const { return pose_log_; }
  // Empty for a resumed session until a stream attaches: the store has only the token's digest.
  std::string resume_token() const;
  bool IsTokenValid(absl::string_view resume_token) const;
  SessionSnapshot Snapshot() const;
  void AddTo(SessionTotals& totals) const;
  SessionInfo Describe() const { return {name(), config_, create_time_, Snapshot()}; }
  SessionSums Sums() const;                       // for the log
  std::optional<absl::Time> expire_time() const;  // absent while a stream is attached

  WatchView Watch() const override;
  std::vector<StoredPose> ReadPoses(uint64_t after_pose_seq, size_t max_poses) const override {
    return pose_log_.Read(after_pose_seq, max_poses);
  }
  uint64_t max_poses_behind() const override { return kMaxLivePosesBehind; }
  SessionHealth health() const override { return Snapshot().health; }
  std::shared_ptr<EventImages> event_images() const override { return images_; }
  void AddWatcher(std::weak_ptr<SessionListener> watcher) override { watchers_->Add(std::move(watcher)); }

  // The calls of a stream. Their statuses and reasons are those that the API promises for Track.
  // Attach() fences the previous stream: the status of its view is then ABORTED. `origin` is for the log. If
  // the session expects an item before `first_seq`, which the client no longer has, the session closes with DATA_LOSS
  // (ROLLED_BACK).
  absl::StatusOr<Attachment> Attach(absl::string_view resume_token, uint64_t last_pose_seq,
                                    std::weak_ptr<SessionListener> listener, const StreamOrigin& origin = {},
                                    uint64_t first_seq = 0);
  void Detach(uint64_t stream);
  // The client of the stream has half-closed it: what it has sent is persisted as soon as it has been processed.
  void HalfClose(uint64_t stream);
  // A push is accepted even without room. Memory stays bounded because a stream reads only while StreamView::has_room
  // is true.
  absl::Status PushEvents(uint64_t stream, EventChunk chunk);
  absl::Status PushResetPose(uint64_t stream, uint64_t seq, absl::string_view object_id,
                             const RigidTransform& camera_from_object);
  absl::Status PushEnd(uint64_t stream);
  StreamView View(uint64_t stream) const;
  std::vector<SessionNotice> TakeNotices(uint64_t stream);
  // Reports that the stream has sent the poses up to this one. A session that waits for its reader then continues.
  void ReportSent(uint64_t stream, uint64_t pose_seq);

  // Renews the lifecycle record, by which other servers see that a server holds the session, while a stream is attached
  // (OrphanCollector).
  void RenewOwnership();
  // Replaces the resume token. Calls `done` when the new token has been persisted. The previous one stays valid until a
  // stream with the new one sends an item. Errors: the status with which the session has closed.
  void RenewToken(absl::AnyInvocable<void(absl::StatusOr<std::string>)> done);
  // Ends the session and its streams with this status, which is not OK. Later calls have no effect.
  void Close(const absl::Status& status);
  // Stops processing after the item in work, and then writes a checkpoint.
  void Flush();
  // Returns, after Flush(), whether everything that was processed has been persisted, or the session is closed.
  bool IsFlushed() const;

 private:
  Session(SessionParts parts, WorkerPool& pool);

  void Enqueue(uint64_t stream, std::variant<EventChunk, PoseReset, EndOfInput> what)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool IsRunnable() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool HasWork() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Posts Run as the next step when there is something to do. To be called after each change that IsRunnable depends
  // on.
  void Schedule() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  SessionAck MakeAck() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  Backlog MakeBacklog() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  CheckpointPolicy::Counters MakeCounters() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  uint64_t FirstPoseSeqToKeep() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  int64_t QueueAgeUs() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  int64_t MicrosecondsSince(SteadyTime begin) const;
  // Returns the change if the session has begun or ceased to fall behind its camera.
  std::optional<LagChange> UpdatePace(int64_t sensor_time_us) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  // The next four functions are called without the lock.
  void NotifyListeners(const std::shared_ptr<SessionListener>& stream_listener);  // may be null
  void CommitLifecycle();                                                         // when it has changed
  void OnCommitProgress();
  void AnswerTokenRequests();

  // Runs in the turns of the session only.
  void Run();
  void EndOutOfMemory(const absl::Status& status);
  bool WriteDueCheckpoint();
  void WriteCheckpoint();
  // Adds poses to `out`, and removes the oldest ones from the log if those in the store exceed their limit of bytes.
  void AddPoses(absl::Span<const StoredPose> poses, SessionCommit& out);
  // Returns nullopt when there is no work.
  std::optional<Backlog> StartWork();
  void Publish(const WorkResult& result);

  const std::shared_ptr<const void> memory_charge_;  // the first member, because it is released last
  const std::shared_ptr<SessionLog> log_;
  const SessionConfig config_;
  const SessionLimits limits_;
  const absl::Time create_time_;
  const SessionClocks clocks_;
  const std::shared_ptr<ServerMetrics> metrics_;
  const std::shared_ptr<SessionCommitter> committer_;
  const std::shared_ptr<Watchers> watchers_;
  const std::shared_ptr<EventImages> images_;
  PoseLog pose_log_;
  const std::shared_ptr<SessionTurns> turns_;
  SessionWorker worker_;          // used in the turns
  SegmentSizes stored_segments_;  // likewise

  mutable std::mutex mutex_;
  StreamGate gate_ ABSL_GUARDED_BY(mutex_);
  WorkQueue queue_ ABSL_GUARDED_BY(mutex_);
  SessionReport report_ ABSL_GUARDED_BY(mutex_);
  ArrivalMonitor arrivals_ ABSL_GUARDED_BY(mutex_);
  PaceMonitor pace_ ABSL_GUARDED_BY(mutex_);
  CheckpointPolicy checkpoints_ ABSL_GUARDED_BY(mutex_);
  TokenRequests token_requests_ ABSL_GUARDED_BY(mutex_);
  std::weak_ptr<SessionListener> stream_listener_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::shared_ptr<const void>> model_uses_ ABSL_GUARDED_BY(mutex_);
  bool is_scheduled_ ABSL_GUARDED_BY(mutex_) = false;  // Run has been posted
};

}  // namespace evpose::server
