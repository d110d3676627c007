// SPDX-License-Identifier: Apache-2.0

// Hands what a session wants to have kept to its lease: one commit at a time, in order, again and again while the store
// is away. Knows nothing of tracking.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "server/runtime/worker_pool.h"
#include "server/stores/common/store.h"
#include "server/telemetry/metrics.h"
#include "server/telemetry/session_log.h"

namespace evpose::server {

// Thread-safe.
class SessionCommitter : public std::enable_shared_from_this<SessionCommitter> {
 public:
  struct Backoff {
    absl::Duration first = absl::Milliseconds(100);  // doubled each time
    absl::Duration longest = absl::Seconds(5);
  };

  // What a session has come to. Each replaces the one before; poses continue the log.
  struct Checkpoint {
    std::optional<std::string> state;  // absent: only the poses
    uint64_t seq = 0;                  // that the state holds everything up to
    std::optional<PoseSegment> poses;
    uint64_t first_pose_seq_kept = 1;
    std::optional<absl::Time> ended_at;  // no more will come
    // When making it began, for what is told of how long things took.
    std::chrono::steady_clock::time_point begun_at = std::chrono::steady_clock::now();
  };

  struct Progress {
    uint64_t lifecycle = 0;  // the number of the newest lifecycle that is durable
    uint64_t seq = 0;        // of the newest state that is
    uint64_t last_pose_seq = 0;
    bool ended = false;
    bool has_waiting = false;  // a checkpoint is on its way to the store
    bool store_is_away = false;
    // The end, in the words for the session's clients: ABORTED (FENCED), NOT_FOUND (SESSION_DELETED),
    // RESOURCE_EXHAUSTED (STORE_FULL), UNAVAILABLE (DRAINING, the store was closed), INTERNAL (STORE_FAILED).
    absl::Status failure;
  };

  // `durable`: what the store has already.
  SessionCommitter(std::shared_ptr<const SessionLog> log, std::unique_ptr<SessionLease> lease, const Progress& durable,
                   WorkerPool& pool, const Backoff& backoff, std::shared_ptr<ServerMetrics> metrics);
  // The lock shows to tools that all calls are over.
  ~SessionCommitter() { const std::lock_guard lock(mutex_); }

  // Called after each change of Progress, without a lock, from a thread of the store; must not block. To be set before
  // the first commit.
  void SetListener(std::function<void()> listener) { listener_ = std::move(listener); }

  // Neither may be called with a lock that the listener takes. A lifecycle whose number is not above those before is
  // old, and ignored.
  void CommitLifecycle(uint64_t number, std::string lifecycle);
  void CommitCheckpoint(Checkpoint checkpoint);

  Progress progress() const;
  uint64_t fencing_number() const { return lease_->fencing_number(); }

  // Nothing is begun afterwards.
  void Close();

 private:
  // What goes into one commit.
  struct Batch {
    SessionCommit commit;
    uint64_t lifecycle = 0;  // 0: none
    uint64_t seq = 0;
    uint64_t last_pose_seq = 0;
    bool has_checkpoint = false;
    std::chrono::steady_clock::time_point begun_at;  // of its first checkpoint

    bool is_empty() const { return lifecycle == 0 && !has_checkpoint; }
    void Append(Batch later);
  };

  void Add(Batch batch);
  void StartCommit();
  void OnDone(const absl::Status& status);
  void RecordDone() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void RetryLater() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  absl::Status FailureOf(const absl::Status& status) const;
  void CountFailure(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const std::shared_ptr<const SessionLog> log_;
  const std::unique_ptr<SessionLease> lease_;
  WorkerPool& pool_;
  const Backoff backoff_;
  const std::shared_ptr<ServerMetrics> metrics_;
  std::function<void()> listener_;

  mutable std::mutex mutex_;
  Progress progress_ ABSL_GUARDED_BY(mutex_);
  uint64_t newest_lifecycle_ ABSL_GUARDED_BY(mutex_);
  Batch waiting_ ABSL_GUARDED_BY(mutex_);
  Batch in_flight_ ABSL_GUARDED_BY(mutex_);  // kept until the store has it
  bool is_in_flight_ ABSL_GUARDED_BY(mutex_) = false;
  bool is_closed_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Duration retry_after_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<PoolTimer> timer_ ABSL_GUARDED_BY(mutex_);  // while the store is away
};

}  // namespace evpose::server
