// SPDX-License-Identifier: Apache-2.0

// One mutex for each key. It serialises the work on the object that the key identifies.
#pragma once

#include <algorithm>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "server/runtime/slow_executor.h"

namespace evpose::server {

// The mutex of a key exists while it is locked or waited for. Thread-safe. `Key` is compared with ==; few keys are
// locked at a time.
template <typename Key>
class KeyedMutexes {
 public:
  struct Unlock {  // deletes a Lock
    void operator()(std::mutex* locked) const { locked->unlock(); }
    std::shared_ptr<std::mutex> mutex;
  };
  // Keeps the mutex of a key locked until it is destroyed. It may outlive the KeyedMutexes.
  using Lock = std::unique_ptr<std::mutex, Unlock>;

  // Waits until no other lock of the key exists. An item of slow work that has to wait leaves its place meanwhile
  // (SlowExecutor::LeavePlaceToWait()).
  [[nodiscard]] Lock LockKey(const Key& key) ABSL_NO_THREAD_SAFETY_ANALYSIS {
    std::shared_ptr<std::mutex> mutex = MutexOf(key);
    if (!mutex->try_lock()) {
      SlowExecutor::LeavePlaceToWait();
      mutex->lock();
    }
    std::mutex* const locked = mutex.get();
    return Lock(locked, Unlock{std::move(mutex)});
  }

 private:
  std::shared_ptr<std::mutex> MutexOf(const Key& key) {
    const std::lock_guard lock(mutex_);
    std::erase_if(mutexes_, [](const auto& entry) { return entry.second.expired(); });
    const auto found =
        std::find_if(mutexes_.begin(), mutexes_.end(), [&key](const auto& entry) { return entry.first == key; });
    // Another thread may release the mutex at any time.
    std::shared_ptr<std::mutex> mutex = found == mutexes_.end() ? nullptr : found->second.lock();
    if (mutex != nullptr) return mutex;
    mutex = std::make_shared<std::mutex>();
    mutexes_.emplace_back(key, mutex);
    return mutex;
  }

  std::mutex mutex_;
  std::vector<std::pair<Key, std::weak_ptr<std::mutex>>> mutexes_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
