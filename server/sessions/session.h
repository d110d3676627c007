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
#include "server/sessions/latency_histogram.h"
#include "server/sessions/session_config.h"
#include "server/sessions/session_pipeline.h"
#include "server/sessions/worker_pool.h"
#include "server/stores/store.h"

namespace evpose::server {

struct SessionLimits {
  uint64_t credit_bytes = 4ull << 20;  // undecoded bytes that may wait; at least max_chunk_bytes
  uint32_t max_chunk_bytes = 1u << 20;
  absl::Duration expiry = absl::Minutes(10);  // without a stream
};

// Told that something of a session has changed: poses, health, acks, room, its end. Called without the session's lock,
// from any thread; must not block. What changed is asked for.
class SessionListener {
 public:
  virtual ~SessionListener() = default;
  virtual void OnSessionChanged() = 0;
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
struct SessionNotice {
  uint64_t after_pose_seq = 0;  // its place among the poses
  std::variant<DecodeFault, StateChange> what;
};

struct SessionAck {
  uint64_t processed_seq = 0;
  uint64_t send_limit_bytes = 0;
  uint64_t last_pose_seq = 0;  // of the chunks up to processed_seq

  friend bool operator==(const SessionAck&, const SessionAck&) = default;
};

struct ObjectHealth {
  TrackState state = TrackState::kInitializing;
  uint32_t losses = 0;
  float explained_ratio = 0.0f;  // of the latest pose
  InitializationReport initialization;
};
struct SessionHealth {
  int64_t t_us = 0;
  uint64_t received_bytes = 0;
  uint64_t processed_bytes = 0;
  DecodeCounts counts;
  uint64_t poses = 0;
  uint32_t reattaches = 0;
  int64_t sensor_time_us = 0;  // from the first time seen to t_us
  int64_t processing_us = 0;
  int64_t queue_age_us = 0;
  int64_t latency_p50_us = 0;
  int64_t latency_p99_us = 0;
  std::vector<ObjectHealth> objects;
};

enum class SessionState { kDetached, kAttached, kEnded };

struct SessionSnapshot {
  SessionState state = SessionState::kDetached;
  absl::Status closed;  // not OK: the session is no more
  std::optional<absl::Time> expire_time;
  SessionHealth health;
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
  bool is_idle = false;   // everything pushed was processed
  bool ended = false;     // `end` was processed
  SessionAck ack;
  uint64_t last_pose_seq = 0;
};

// What a reader must know to go on.
struct WatchView {
  absl::Status status;  // not OK: the session is no more
  bool ended = false;   // no more poses will come
  uint64_t last_pose_seq = 0;
};

class Session : public std::enable_shared_from_this<Session> {
 public:
  // A pose stream may be so far behind before the session waits for its reader.
  static constexpr uint64_t kMaxUnsentPoses = 1024;

  struct Parts {
    std::string name;
    SessionConfig config;
    SessionLimits limits;
    std::vector<std::shared_ptr<const void>> model_uses;  // let go when the session closes
    std::unique_ptr<SessionPipeline> pipeline;
    std::shared_ptr<PoseLog> pose_log;
    std::string resume_token;
    absl::AnyInvocable<absl::Time() const> now;
  };
  Session(Parts parts, WorkerPool& pool);
  ~Session();

  const std::string& name() const { return name_; }
  const SessionConfig& config() const { return config_; }
  const SessionLimits& limits() const { return limits_; }
  absl::Time create_time() const { return create_time_; }
  const std::shared_ptr<PoseLog>& pose_log() const { return pose_log_; }
  std::string resume_token() const;
  SessionSnapshot Snapshot() const;
  std::optional<absl::Time> expire_time() const;  // absent while a stream is attached

  WatchView Watch() const;
  void AddWatcher(std::weak_ptr<SessionListener> watcher);

  // The data plane; statuses and reasons are those that the API promises for Track.
  // Attaching fences the stream before: its view's status is ABORTED from now on.
  absl::StatusOr<Attachment> Attach(absl::string_view resume_token, uint64_t last_pose_seq,
                                    std::weak_ptr<SessionListener> listener);
  void Detach(uint64_t stream);
  // Who pushes without room is not refused: memory stays bounded because a stream reads only when there is room.
  absl::Status PushEvents(uint64_t stream, EventChunk chunk);
  absl::Status PushResetPose(uint64_t stream, absl::string_view object_id, const RigidTransform& camera_from_object);
  absl::Status PushEnd(uint64_t stream);
  StreamView View(uint64_t stream) const;
  std::vector<SessionNotice> TakeNotices(uint64_t stream);
  // The stream has sent the poses up to this one: the session may go on.
  void ReportSent(uint64_t stream, uint64_t pose_seq);

  // Ends everything with this status, which is not OK. The first one counts.
  void Close(const absl::Status& status);

 private:
  using SteadyTime = std::chrono::steady_clock::time_point;
  struct PoseReset {
    uint32_t object_index = 0;
    RigidTransform camera_from_object;
  };
  struct End {};
  struct Item {
    uint64_t stream = 0;
    SteadyTime received_at;
    std::variant<EventChunk, PoseReset, End> what;

    uint64_t bytes() const;
  };

  absl::Status CheckStream(uint64_t stream) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::Status CheckPush(uint64_t stream) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::Status CheckPayload(const EventChunk& chunk) const;
  void Enqueue(uint64_t stream, std::variant<EventChunk, PoseReset, End> what) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool IsRunnable() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Schedule() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  uint64_t SendLimit() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  SessionAck MakeAck() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  std::vector<std::shared_ptr<SessionListener>> Listeners() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  // On the strand only.
  void Run();
  bool TakeItem();
  bool WorkOnItem();
  bool WorkOnEvents(const EventChunk& chunk);
  void Publish(bool item_is_done);
  std::vector<StoredPose> NumberPoses();
  std::optional<DecodeFault> FindDecodeFault() const;

  const std::string name_;
  const SessionConfig config_;
  const SessionLimits limits_;
  const std::shared_ptr<PoseLog> pose_log_;
  const absl::AnyInvocable<absl::Time() const> now_;
  const absl::Time create_time_;
  Strand strand_;

  // Of the strand.
  std::unique_ptr<SessionPipeline> pipeline_;
  PipelineOutput output_;
  std::optional<Item> item_;
  size_t item_offset_ = 0;
  DecodeCounts counts_before_item_;
  uint64_t next_pose_seq_ = 1;
  std::chrono::steady_clock::duration processing_time_{0};
  std::vector<float> explained_ratios_;

  mutable std::mutex mutex_;
  std::deque<Item> queue_ ABSL_GUARDED_BY(mutex_);
  uint64_t queued_bytes_ ABSL_GUARDED_BY(mutex_) = 0;                // the item in work included
  std::optional<SteadyTime> in_work_since_ ABSL_GUARDED_BY(mutex_);  // receipt of the item in work
  bool is_scheduled_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status closed_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::shared_ptr<const void>> model_uses_ ABSL_GUARDED_BY(mutex_);
  std::string resume_token_ ABSL_GUARDED_BY(mutex_);
  std::string previous_token_ ABSL_GUARDED_BY(mutex_);
  uint64_t stream_ ABSL_GUARDED_BY(mutex_) = 0;  // the latest; 0: none yet
  bool is_attached_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Time detached_at_ ABSL_GUARDED_BY(mutex_);
  uint64_t next_seq_ ABSL_GUARDED_BY(mutex_) = 1;
  uint64_t processed_seq_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t acked_pose_seq_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t consumed_bytes_ ABSL_GUARDED_BY(mutex_) = 0;  // of this stream: processed or ignored
  uint64_t foreign_bytes_ ABSL_GUARDED_BY(mutex_) = 0;   // queued by earlier streams
  uint64_t sent_pose_seq_ ABSL_GUARDED_BY(mutex_) = 0;
  bool end_pushed_ ABSL_GUARDED_BY(mutex_) = false;
  bool ended_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<SessionNotice> notices_ ABSL_GUARDED_BY(mutex_);
  SessionHealth health_ ABSL_GUARDED_BY(mutex_);
  LatencyHistogram latencies_ ABSL_GUARDED_BY(mutex_);
  std::weak_ptr<SessionListener> stream_listener_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::weak_ptr<SessionListener>> watchers_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
