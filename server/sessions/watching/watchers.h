// SPDX-License-Identifier: Apache-2.0

// Notifies the watchers of a session.
#pragma once

#include <cstddef>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/inlined_vector.h"
#include "server/runtime/worker_pool.h"

namespace evpose::server {

// Called after a change of a session: poses, health, acks, room, its end. Called without the session's lock, from any
// thread; must not block. The listener reads the new state itself.
class SessionListener {
 public:
  virtual ~SessionListener() = default;
  virtual void OnSessionChanged() = 0;
};

// Thread-safe. The cost of a change for the session does not depend on the number of watchers: a thread of the pool
// calls them, a few at a time, so that the watchers of other sessions have their turn. Changes during a round through
// the watchers cause one more round after it.
class Watchers : public std::enable_shared_from_this<Watchers> {
 public:
  // Calls the watchers on the low-priority thread.
  explicit Watchers(WorkerPool& pool) : pool_(pool) {}
  // Calls the watchers in the turns of their tenant (WorkerPool::images), for images of events, which take
  // milliseconds.
  Watchers(WorkerPool& pool, std::string tenant) : pool_(pool), tenant_(std::move(tenant)) {}
  // The lock shows to race detectors that all calls have ended.
  ~Watchers() { const std::lock_guard lock(mutex_); }

  void Add(std::weak_ptr<SessionListener> watcher);
  // Each watcher is called at least once after this.
  void Notify();

  size_t size() const;  // includes destroyed watchers until the next round, or until memory would grow

 private:
  // Watchers that are called in one task of the thread. Each may serialize a page of poses, or compress an image, which
  // takes milliseconds. With more of them, the watchers of other sessions wait longer for their turn.
  static constexpr size_t kWatchersPerTurn = 16;
  static constexpr size_t kImagesPerTurn = 1;

  void RemoveDestroyed() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Posts the next turn of a round. If there is no memory for it, the round ends, and the next change begins another
  // one.
  void Post() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void CallSome();
  absl::InlinedVector<std::shared_ptr<SessionListener>, kWatchersPerTurn> NextOnes();

  WorkerPool& pool_;
  const std::optional<std::string> tenant_;  // of images
  mutable std::mutex mutex_;
  std::vector<std::weak_ptr<SessionListener>> watchers_ ABSL_GUARDED_BY(mutex_);
  bool is_in_round_ ABSL_GUARDED_BY(mutex_) = false;
  bool has_changed_again_ ABSL_GUARDED_BY(mutex_) = false;
  size_t next_ ABSL_GUARDED_BY(mutex_) = 0;  // watcher of the current round
};

}  // namespace evpose::server
