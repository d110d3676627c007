// SPDX-License-Identifier: Apache-2.0

// Periodic health check of the store: a server whose store does not respond is not ready.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "server/runtime/worker_pool.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Thread-safe.
class StoreCheck {
 public:
  // Called at every change; the initial state is true. It must not block or call the StoreCheck.
  using Listener = std::function<void(bool is_healthy)>;

  // Checks the store `period` after its last response, on the pool's threads for slow work, because a response may take
  // seconds. The arguments must live until the pool's Join() has returned.
  StoreCheck(Store& store, WorkerPool& pool, absl::Duration period, Listener listener);
  // Locks, so that ThreadSanitizer sees that all calls precede the destruction.
  ~StoreCheck() { const std::lock_guard lock(mutex_); }

  void Start();
  // Afterwards the listener is not called and the store is not checked. May be called before Start().
  void Stop();
  // The result of the last check; OK before the first one.
  absl::Status health() const;
  // The bytes in use at the last check to which the store has responded.
  std::optional<StoreUsage> usage() const;

 private:
  void OnTimer();
  // After a failed allocation, which is no evidence about the store, the result of the last check remains.
  void Check();
  void SetHealth(const absl::Status& health) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Logs the groups of the store that have stopped to respond, or respond again.
  void LogChanges(const std::vector<StoreGroup>& groups) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  Store& store_;
  WorkerPool& pool_;
  const absl::Duration period_;
  const Listener listener_;
  mutable std::mutex mutex_;
  absl::Status health_ ABSL_GUARDED_BY(mutex_);
  std::optional<StoreUsage> usage_ ABSL_GUARDED_BY(mutex_);
  std::set<std::string> unavailable_groups_ ABSL_GUARDED_BY(mutex_);
  bool is_stopped_ ABSL_GUARDED_BY(mutex_) = false;
  std::unique_ptr<ReusableTimer> timer_ ABSL_GUARDED_BY(mutex_);  // null before Start() and after Stop()
};

}  // namespace evpose::server
