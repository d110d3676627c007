// SPDX-License-Identifier: Apache-2.0

// Read-only replica, for watchers, of a session that another server on the same store holds.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/functional/any_invocable.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/runtime/worker_pool.h"
#include "server/sessions/session_factory.h"
#include "server/sessions/watching/watched_session.h"

namespace evpose::server {

// Thread-safe. Reads the store periodically as long as it is referenced. Its poses therefore arrive in groups, one
// checkpoint late or more.
class SessionMirror : public WatchedSession, public std::enable_shared_from_this<SessionMirror> {
 public:
  // Reads the session and its poses after `after_pose_seq`. Waits for the store. Errors: those of SessionFactory::Read.
  using ReadStored = absl::AnyInvocable<absl::StatusOr<SessionFactory::Stored>(uint64_t after_pose_seq) const>;

  // `stored` is the present state in the store. Keeps the last `capacity` poses. The next read starts a `period` after
  // the end of the previous one.
  static std::shared_ptr<SessionMirror> Start(SessionFactory::Stored stored, ReadStored read, size_t capacity,
                                              absl::Duration period, WorkerPool& pool);
  ~SessionMirror() override;

  const SessionConfig& config() const override { return config_; }
  // The status of the view is NOT_FOUND (SESSION_DELETED) when the store no longer has the session, or DATA_LOSS
  // (SESSION_DAMAGED; ROLLED_BACK: the store and the client have lost chunks). It stays the same while the store is
  // unreachable.
  WatchView Watch() const override;
  std::vector<StoredPose> ReadPoses(uint64_t after_pose_seq, size_t max_poses) const override;
  uint64_t max_poses_behind() const override { return capacity_; }
  SessionHealth health() const override;
  void AddWatcher(std::weak_ptr<SessionListener> watcher) override { watchers_->Add(std::move(watcher)); }

 private:
  SessionMirror(const SessionFactory::Stored& stored, ReadStored read, size_t capacity, absl::Duration period,
                WorkerPool& pool);
  // Starts the wait for the next read, unless nothing can follow. Allocates nothing.
  void Schedule() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void OnTimer();
  void Refresh();
  // Returns whether something has changed for watchers.
  bool Update(absl::StatusOr<SessionFactory::Stored> stored) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const std::string name_;
  const SessionConfig config_;
  const ReadStored read_;
  const size_t capacity_;
  const absl::Duration period_;
  WorkerPool& pool_;
  const std::shared_ptr<Watchers> watchers_;
  mutable std::mutex mutex_;
  std::unique_ptr<PoseLog> pose_log_ ABSL_GUARDED_BY(mutex_);  // replaced after a gap: poses deleted before a read
  SessionHealth health_ ABSL_GUARDED_BY(mutex_);
  absl::Status status_ ABSL_GUARDED_BY(mutex_);
  bool has_ended_ ABSL_GUARDED_BY(mutex_) = false;
  std::unique_ptr<ReusableTimer> timer_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
