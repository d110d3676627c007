// SPDX-License-Identifier: Apache-2.0

// A thread with a queue of jobs.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <functional>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "server/stores/common/checked_lease.h"

namespace evpose::server {

// Passes all waiting jobs to `process` at once, in the order of their arrival, so that a store can write them in one
// batch. Thread-safe.
template <typename Job>
class JobThread {
 public:
  // `process` runs on the thread and receives at least one job.
  explicit JobThread(std::function<void(std::vector<Job>)> process)
      : process_(std::move(process)), thread_([this] { Run(); }) {}
  ~JobThread() { Close(); }
  JobThread(const JobThread&) = delete;
  JobThread& operator=(const JobThread&) = delete;

  // Queues a job. After Close() it calls `job.done` with StoreClosedError() instead.
  void Push(Job job) {
    {
      std::unique_lock lock(mutex_);
      if (is_closed_) {
        lock.unlock();
        return job.done(StoreClosedError());
      }
      waiting_.push_back(std::move(job));
    }
    changed_.notify_one();
  }

  // Processes the queued jobs and stops the thread. To be called by one thread, other than the job thread.
  void Close() {
    {
      const std::lock_guard lock(mutex_);
      is_closed_ = true;
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

  // Blocks until a job is queued or the queue is closed. An empty result means that the queue is closed and drained.
  std::vector<Job> TakeAll() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return is_closed_ || !waiting_.empty(); });
    return std::exchange(waiting_, {});
  }

  const std::function<void(std::vector<Job>)> process_;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool is_closed_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<Job> waiting_ ABSL_GUARDED_BY(mutex_);
  std::thread thread_;  // the last member, because it uses the others
};

}  // namespace evpose::server
