// SPDX-License-Identifier: Apache-2.0

// A cache of immutable objects that several sessions share, for example lookup tables of a camera.
#pragma once

#include <algorithm>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"

namespace evpose::server {

// Holds one value for each key. A value lives as long as a caller holds it: the cache has weak references. Thread-safe.
template <typename Key, typename Value>
class WeakCache {
 public:
  // Returns the value of `key`. When no caller holds it, `make()` creates it; `make` returns
  // absl::StatusOr<std::shared_ptr<const Value>>. Errors: those of `make`.
  template <typename Make>
  absl::StatusOr<std::shared_ptr<const Value>> Get(const Key& key, const Make& make) {
    {
      const std::lock_guard lock(mutex_);
      if (auto value = Find(key); value != nullptr) return value;
    }
    // `make` runs without the lock, so that calls for other keys do not wait. When two threads create the same value at
    // the same time, both use the one that was stored first.
    absl::StatusOr<std::shared_ptr<const Value>> made = make();
    if (!made.ok()) return made.status();
    const std::lock_guard lock(mutex_);
    if (auto value = Find(key); value != nullptr) return value;
    in_use_.emplace_back(key, *made);
    return *std::move(made);
  }

 private:
  std::shared_ptr<const Value> Find(const Key& key) {
    std::erase_if(in_use_, [](const auto& entry) { return entry.second.expired(); });
    const auto found =
        std::find_if(in_use_.begin(), in_use_.end(), [&key](const auto& entry) { return entry.first == key; });
    return found == in_use_.end() ? nullptr : found->second.lock();
  }

  std::mutex mutex_;
  std::vector<std::pair<Key, std::weak_ptr<const Value>>> in_use_;
};

}  // namespace evpose::server
