// SPDX-License-Identifier: Apache-2.0

// Asks the store now and then whether it answers: a server without its store is not ready.
#pragma once

#include <boost/asio/steady_timer.hpp>
#include <functional>
#include <memory>
#include <mutex>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "server/runtime/worker_pool.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Thread-safe.
class StoreCheck {
 public:
  // Told of every change, of which the first can only be to false; must not block, nor call back.
  using Listener = std::function<void(bool answers)>;

  // The store is asked `period` after its last answer, by the pool's slow thread: an answer may take seconds. All that
  // is given outlives the pool's Join().
  StoreCheck(Store& store, WorkerPool& pool, absl::Duration period, Listener listener);
  // The lock shows to tools that all calls are over.
  ~StoreCheck() { const std::lock_guard lock(mutex_); }

  void Start();
  // The listener is not called afterwards, and the store not asked again, whether it was started or not.
  void Stop();
  // Its last one; UNAVAILABLE saying why it does not.
  absl::Status answer() const;

 private:
  void Arm() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Ask();
  bool IsStopped();

  Store& store_;
  WorkerPool& pool_;
  const absl::Duration period_;
  const Listener listener_;
  mutable std::mutex mutex_;
  absl::Status answer_ ABSL_GUARDED_BY(mutex_);
  bool is_stopped_ ABSL_GUARDED_BY(mutex_) = false;
  std::unique_ptr<PoolTimer> timer_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
