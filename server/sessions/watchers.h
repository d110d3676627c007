// SPDX-License-Identifier: Apache-2.0

// Those who look on at a session beside its stream, and how they learn that something has changed.
#pragma once

#include <cstddef>
#include <memory>
#include <mutex>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "server/runtime/worker_pool.h"

namespace evpose::server {

// Told that something of a session has changed: poses, health, acks, room, its end. Called without the session's lock,
// from any thread; must not block. What changed is asked for.
class SessionListener {
 public:
  virtual ~SessionListener() = default;
  virtual void OnSessionChanged() = 0;
};

// Thread-safe. What a change costs the session does not depend on how many watch: they are told by the pool's side
// thread, a few at a time, so that the watchers of other sessions have their turn. Changes that come while a round
// through the watchers is on its way are told together, in one round after it.
class Watchers : public std::enable_shared_from_this<Watchers> {
 public:
  explicit Watchers(WorkerPool& pool) : pool_(pool) {}
  // The lock shows to tools that all calls are over.
  ~Watchers() { const std::lock_guard lock(mutex_); }

  void Add(std::weak_ptr<SessionListener> watcher);
  // Each watcher is told after this, at least once.
  void Notify();

  size_t size() const;  // those that have gone are forgotten in the next round, or before memory grows

 private:
  void ForgetGone() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Post() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Turn();
  std::vector<std::shared_ptr<SessionListener>> NextFew();

  WorkerPool& pool_;
  mutable std::mutex mutex_;
  std::vector<std::weak_ptr<SessionListener>> watchers_ ABSL_GUARDED_BY(mutex_);
  bool is_under_way_ ABSL_GUARDED_BY(mutex_) = false;
  bool has_changed_again_ ABSL_GUARDED_BY(mutex_) = false;
  size_t next_ ABSL_GUARDED_BY(mutex_) = 0;  // of the round that is under way
};

}  // namespace evpose::server
