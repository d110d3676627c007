// SPDX-License-Identifier: Apache-2.0

// Waits for a condition that changes of sessions may fulfil.
#pragma once

#include <condition_variable>
#include <mutex>

#include "absl/time/time.h"
#include "server/sessions/watching/watchers.h"

namespace evpose::server {

class WaitingListener : public SessionListener {
 public:
  void OnSessionChanged() override {
    const std::lock_guard lock(mutex_);
    changed_.notify_all();
  }
  // Waits until `is_true()`, which is called after each change.
  template <typename Predicate>
  void WaitUntil(Predicate is_true) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, is_true);
  }
  // The same, at the longest until the deadline. Returns whether the condition is fulfilled.
  template <typename Predicate>
  bool WaitUntil(absl::Time deadline, Predicate is_true) {
    std::unique_lock lock(mutex_);
    return changed_.wait_until(lock, absl::ToChronoTime(deadline), is_true);
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
};

}  // namespace evpose::server
