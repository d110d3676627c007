// SPDX-License-Identifier: Apache-2.0

// A cache of immutable objects that several sessions share, for example lookup tables of a camera.
#pragma once

#include <algorithm>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "server/runtime/keyed_mutexes.h"

namespace evpose::server {

// Holds one value for each key. A value lives as long as a caller holds it: the cache has weak references. Thread-safe.
template <typename Key, typename Value>
class WeakCache {
 public:
  // Returns the value of `key`. When no caller holds it, `make()` creates it; `make` returns
  // absl::StatusOr<std::shared_ptr<const Value>>. Calls for the same key wait while one of them creates the value; if
  // that fails, the next one tries. Must not be called in a turn of a session (FairScheduler), which may be paused at a
  // yield point of `make` while others wait; SlowExecutor::OrCancelled() never pauses. Errors: those of `make`.
  template <typename Make>
  absl::StatusOr<std::shared_ptr<const Value>> Get(const Key& key, const Make& make) {
    if (auto value = Find(key); value != nullptr) return value;
    // `make` runs without mutex_, so that calls for other keys do not wait.
    const auto one_at_a_time = making_.LockKey(key);
    if (auto value = Find(key); value != nullptr) return value;
    absl::StatusOr<std::shared_ptr<const Value>> made = make();
    if (!made.ok()) return made.status();
    const std::lock_guard lock(mutex_);
    in_use_.emplace_back(key, *made);
    return *std::move(made);
  }

 private:
  std::shared_ptr<const Value> Find(const Key& key) {
    const std::lock_guard lock(mutex_);
    std::erase_if(in_use_, [](const auto& entry) { return entry.second.expired(); });
    const auto found =
        std::find_if(in_use_.begin(), in_use_.end(), [&key](const auto& entry) { return entry.first == key; });
    return found == in_use_.end() ? nullptr : found->second.lock();
  }

  KeyedMutexes<Key> making_;
  std::mutex mutex_;
  std::vector<std::pair<Key, std::weak_ptr<const Value>>> in_use_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
