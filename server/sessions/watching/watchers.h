// SPDX-License-Identifier: Apache-2.0

// Notification of the watchers of a session.
#pragma once

#include <cstddef>
#include <memory>
#include <mutex>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "server/runtime/worker_pool.h"

namespace evpose::server {

// Called after a change of a session: poses, health, acks, room, its end. Called without the session's lock, from any
// thread; must not block. The listener reads the new state itself.
class SessionListener {
 public:
  virtual ~SessionListener() = default;
  virtual void OnSessionChanged() = 0;
};

// Thread-safe. The cost of a change for the session does not depend on the number of watchers: the pool's low-priority
// thread calls them, a few at a time, so that the watchers of other sessions have their turn. Changes during a round
// through the watchers cause one more round after it.
class Watchers : public std::enable_shared_from_this<Watchers> {
 public:
  explicit Watchers(WorkerPool& pool) : pool_(pool) {}
  // The lock shows to race detectors that all calls have ended.
  ~Watchers() { const std::lock_guard lock(mutex_); }

  void Add(std::weak_ptr<SessionListener> watcher);
  // Each watcher is called at least once after this.
  void Notify();

  size_t size() const;  // includes destroyed watchers until the next round, or until memory would grow

 private:
  void RemoveDestroyed() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Post() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void CallSome();
  std::vector<std::shared_ptr<SessionListener>> NextOnes();

  WorkerPool& pool_;
  mutable std::mutex mutex_;
  std::vector<std::weak_ptr<SessionListener>> watchers_ ABSL_GUARDED_BY(mutex_);
  bool is_in_round_ ABSL_GUARDED_BY(mutex_) = false;
  bool has_changed_again_ ABSL_GUARDED_BY(mutex_) = false;
  size_t next_ ABSL_GUARDED_BY(mutex_) = 0;  // watcher of the current round
};

}  // namespace evpose::server
