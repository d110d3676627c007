// SPDX-License-Identifier: Apache-2.0

// What several sessions look up and none changes.
#pragma once

#include <algorithm>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"

namespace evpose::server {

// The part that belongs to each key, for all who use it. It goes with the last of them. Thread-safe.
template <typename Key, typename Part>
class SharedParts {
 public:
  // `make()`, an absl::StatusOr<std::shared_ptr<const Part>>, when nobody has the key's part. Errors are those of it.
  template <typename Make>
  absl::StatusOr<std::shared_ptr<const Part>> Get(const Key& key, const Make& make) {
    {
      const std::lock_guard lock(mutex_);
      if (auto part = Find(key); part != nullptr) return part;
    }
    // Without the lock: others need not wait. Who makes the same at the same time uses what was there first.
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
