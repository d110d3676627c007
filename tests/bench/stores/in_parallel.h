// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <functional>
#include <future>
#include <vector>

#include "absl/status/status.h"

namespace evpose::server {

// Calls `work` for the numbers 0 to count - 1, in threads that each stop at their first error, which is returned. The
// number of threads is large because SQLite writes the waiting sessions of all threads in one transaction.
inline absl::Status InParallel(size_t count, const std::function<absl::Status(size_t)>& work) {
  constexpr int kThreads = 64;
  std::atomic<size_t> next = 0;
  std::vector<std::future<absl::Status>> threads;
  for (int i = 0; i < kThreads; ++i) {
    threads.push_back(std::async(std::launch::async, [&] {
      absl::Status status;
      for (size_t number = next++; status.ok() && number < count; number = next++) status = work(number);
      return status;
    }));
  }
  absl::Status status;
  for (auto& thread : threads) status.Update(thread.get());
  return status;
}

}  // namespace evpose::server
