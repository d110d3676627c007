// SPDX-License-Identifier: Apache-2.0

// Commits a session's lifecycle records and checkpoints to the store: one commit at a time, in order, repeated while
// the store is unreachable.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
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
  // Delays before a commit is repeated. A session notices up to `longest` later that the store is back.
  struct Backoff {
    absl::Duration first = absl::Milliseconds(100);  // doubled with each repetition
    absl::Duration longest = absl::Seconds(1);
  };

  struct Progress {
    // The next four describe the persisted data.
    uint64_t lifecycle = 0;  // number of the newest lifecycle record
    uint64_t seq = 0;        // last item that the newest checkpoint includes
    uint64_t last_pose_seq = 0;
    bool has_ended = false;
    bool has_waiting = false;  // a checkpoint was passed on and is not persisted yet
    bool is_store_unavailable = false;
    // Not OK if nothing more is persisted. It is the error for the clients of the session: ABORTED (FENCED), NOT_FOUND
    // (SESSION_DELETED), RESOURCE_EXHAUSTED (STORE_FULL; OUT_OF_MEMORY), UNAVAILABLE (DRAINING: the store was closed;
    // ROLLED_BACK: it has lost the last commits), INTERNAL (STORE_FAILED).
    absl::Status failure;
  };

  // `persisted` is the present state in the store.
  SessionCommitter(std::shared_ptr<const SessionLog> log, std::unique_ptr<SessionLease> lease,
                   const Progress& persisted, WorkerPool& pool, const Backoff& backoff,
                   std::shared_ptr<ServerMetrics> metrics);
  // The lock shows to race detectors that all calls have ended.
  ~SessionCommitter() { const std::lock_guard lock(mutex_); }

  // Sets a function that is called after each change of Progress, without a lock, on a thread of the store. It must not
  // block, and handles allocations that fail. To be set before the first commit.
  void SetListener(std::function<void()> listener) { listener_ = std::move(listener); }

  // CommitLifecycle() and CommitCheckpoint() must not be called with a lock that the listener takes. A lifecycle
  // record is ignored if its number is not greater than those before.
  void CommitLifecycle(uint64_t number, std::string lifecycle);
  // `checkpoint` contains a checkpoint, poses that continue the stored log, or both. `seq` is the last item that the
  // checkpoint includes; it is ignored without a checkpoint. `begun_at` is the start of the serialization, for the
  // metrics.
  void CommitCheckpoint(SessionCommit checkpoint, uint64_t seq,
                        std::chrono::steady_clock::time_point begun_at = std::chrono::steady_clock::now());

  Progress progress() const;
  const FencingToken& token() const { return lease_->token(); }

  // Accepts no further records. Those that wait are still committed, also after Close().
  void Finish();
  // Starts no further commit.
  void Close();

 private:
  enum class State {
    kOpen,
    kFinishing,  // accepts no further records; those that wait are committed
    kClosed,     // starts no further commit; final
  };
  // Contents of one commit.
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

  void StartCommit();
  // Does the same as StartCommit(), for callers that do not handle a failed allocation: the session ends if one fails.
  void ContinueCommits();
  void OnDone(const absl::Status& status);
  void Record(const absl::Status& status);
  // The records may not be known as written or as waiting.
  void EndOutOfMemory(const absl::Status& status);
  void CountBytes() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void RecordDone() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void RecordDuration() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);  // of a checkpoint that is durable
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
  Batch in_flight_ ABSL_GUARDED_BY(mutex_);  // kept until it has been persisted, for repetitions
  bool is_in_flight_ ABSL_GUARDED_BY(mutex_) = false;
  bool is_slow_ ABSL_GUARDED_BY(mutex_) = false;  // the last checkpoint took a long time
  State state_ ABSL_GUARDED_BY(mutex_) = State::kOpen;
  absl::Duration retry_after_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<PoolTimer> timer_ ABSL_GUARDED_BY(mutex_);  // until the next repetition; null otherwise
};

}  // namespace evpose::server
