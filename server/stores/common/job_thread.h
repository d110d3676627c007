// SPDX-License-Identifier: Apache-2.0

// A thread of a store, and what waits for it.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <functional>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"

namespace evpose::server {

// Hands over all that waits at once, in order. Thread-safe.
template <typename Job>
class JobThread {
 public:
  // `process` runs on the thread and gets at least one job.
  explicit JobThread(std::function<void(std::vector<Job>)> process)
      : process_(std::move(process)), thread_([this] { Run(); }) {}
  ~JobThread() { Close(); }
  JobThread(const JobThread&) = delete;
  JobThread& operator=(const JobThread&) = delete;

  // False after Close(): the job was not taken, nor touched.
  bool Push(Job&& job) {
    {
      const std::lock_guard lock(mutex_);
      if (closed_) return false;
      waiting_.push_back(std::move(job));
    }
    changed_.notify_one();
    return true;
  }

  // What waits is still processed. By one thread, which is not this one.
  void Close() {
    {
      const std::lock_guard lock(mutex_);
      closed_ = true;
    }
    changed_.notify_one();
    if (thread_.joinable()) thread_.join();
  }

 private:
  void Run() {
    while (true) {
      std::vector<Job> jobs = TakeAll();
      if (jobs.empty()) return;
      process_(std::move(jobs));
    }
  }

  // Empty: closed, and nothing waits.
  std::vector<Job> TakeAll() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return closed_ || !waiting_.empty(); });
    return std::exchange(waiting_, {});
  }

  const std::function<void(std::vector<Job>)> process_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool closed_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<Job> waiting_ ABSL_GUARDED_BY(mutex_);
  std::thread thread_;  // last: it uses what stands above
};

}  // namespace evpose::server
