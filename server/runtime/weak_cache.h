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

// Holds one part for each key. A part lives as long as a caller holds it: the cache has weak references. Thread-safe.
template <typename Key, typename Part>
class SharedParts {
 public:
  // Returns the part of `key`. When no caller holds it, `make()` creates it; `make` returns
  // absl::StatusOr<std::shared_ptr<const Part>>. Errors: those of `make`.
  template <typename Make>
  absl::StatusOr<std::shared_ptr<const Part>> Get(const Key& key, const Make& make) {
    {
      const std::lock_guard lock(mutex_);
      if (auto part = Find(key); part != nullptr) return part;
    }
    // `make` runs without the lock, so that calls for other keys do not wait. When two threads create the same part at
    // the same time, both use the one that was stored first.
    absl::StatusOr<std::shared_ptr<const Part>> made = make();
    if (!made.ok()) return made.status();
    const std::lock_guard lock(mutex_);
    if (auto part = Find(key); part != nullptr) return part;
    in_use_.emplace_back(key, *made);
    return *std::move(made);
  }

 private:
  std::shared_ptr<const Part> Find(const Key& key) {
    in_use_.erase(
        std::remove_if(in_use_.begin(), in_use_.end(), [](const auto& entry) { return entry.second.expired(); }),
        in_use_.end());
    const auto found =
        std::find_if(in_use_.begin(), in_use_.end(), [&key](const auto& entry) { return entry.first == key; });
    return found == in_use_.end() ? nullptr : found->second.lock();
  }

  std::mutex mutex_;
  std::vector<std::pair<Key, std::weak_ptr<const Part>>> in_use_;
};

}  // namespace evpose::server
