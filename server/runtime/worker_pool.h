// SPDX-License-Identifier: Apache-2.0

// The threads that decode and track for all sessions (server/scheduling), threads for slow work, one for timers, one
// for low-priority work, and one for images of events.
#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/thread_pool.hpp>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "absl/time/time.h"
#include "server/runtime/out_of_memory.h"
#include "server/runtime/reusable_timer.h"
#include "server/runtime/slow_executor.h"
#include "server/scheduling/fair_scheduler.h"

namespace evpose::server {

using PoolTimer = boost::asio::steady_timer;

// If memory is exhausted, the posted work ends early, and the process goes on. Steps of sessions guard themselves.
// Must outlive the sessions and their store: a session's turns and timers belong to the pool, and the store's thread
// may hold the last reference to a session.
class WorkerPool {
 public:
  // Items of slow() that compute for long, beside those that do not. Each has a thread of low priority.
  static constexpr int kMaxLongItems = 4;

  // The executors that run the posted work.
  struct Executors {
    boost::asio::any_io_executor work;          // PostAfter() and the turns of sessions
    boost::asio::any_io_executor slow;          // slow() and preparations()
    boost::asio::any_io_executor low_priority;  // PostLowPriority()
    boost::asio::any_io_executor images;        // images()
  };

  // `slow_threads`: number of items that run at a time in each of slow() and preparations(). With two, the item of a
  // tenant waits only while two other tenants have a running one. In slow(), up to kMaxLongItems items that compute for
  // long (SlowExecutor::kLongItem), and `slow_threads` items with Overlap::kAny, run beside these.
  explicit WorkerPool(int num_workers, int slow_threads = 2, FairScheduler::Options options = {})
      : threads_(std::make_unique<Threads>(3 * slow_threads + kMaxLongItems)),
        on_(threads_->executors()),
        slow_(on_.slow, {.running = slow_threads, .long_items = kMaxLongItems, .overlapping = slow_threads}),
        preparations_(on_.slow, {.running = slow_threads}),
        images_(on_.images, {.running = 1}),
        scheduler_(num_workers, std::move(options)) {}
  // Uses the caller's executors. The caller keeps them running until all work posted here has finished.
  explicit WorkerPool(Executors executors, FairScheduler::Options options = {})
      : on_(std::move(executors)),
        slow_(on_.slow, {.running = 1}),
        preparations_(on_.slow, {.running = 1}),
        images_(on_.images, {.running = 1}),
        scheduler_(on_.work, std::move(options)) {}
  // Work that has not started is discarded.
  ~WorkerPool() {
    if (threads_ != nullptr) threads_->Stop();
  }

  // Runs `work` after `delay`, unless the returned timer is destroyed or cancelled before.
  template <typename Work>
  std::unique_ptr<PoolTimer> PostAfter(absl::Duration delay, Work&& work) {
    auto timer = std::make_unique<PoolTimer>(on_.work, absl::ToChronoNanoseconds(delay));
    timer->async_wait([work = std::forward<Work>(work)](const boost::system::error_code& error) mutable {
      if (!error) RunUnlessOutOfMemory(work);
    });
    return timer;
  }
  // A timer, not armed yet, that runs `work` as PostAfter() does.
  std::unique_ptr<ReusableTimer> MakeTimer(std::function<void()> work) {
    return std::make_unique<ReusableTimer>(on_.work, std::move(work));
  }
  // Threads for work that waits for the store or creates trackers.
  SlowExecutor& slow() { return slow_; }
  // Threads for the preparation of models, which takes seconds. They are separate, so that slow() never waits for it.
  SlowExecutor& preparations() { return preparations_; }
  // A thread for images of events, whose compression takes milliseconds. It is separate, so that poses do not wait for
  // images, and its tenants take turns.
  SlowExecutor& images() { return images_; }
  // A thread for many short tasks that may wait for work of higher priority, such as sending poses to watchers.
  template <typename Work>
  void PostLowPriority(Work&& work) {
    boost::asio::post(on_.low_priority, [work = std::forward<Work>(work)]() mutable { RunUnlessOutOfMemory(work); });
  }
  std::shared_ptr<SessionTurns> AddSession(const std::string& tenant, const std::string& trace_id = "") {
    return scheduler_.AddSession(tenant, trace_id);
  }

  // Returns when all work posted to the pool's own threads has finished. Nothing may be posted afterwards. Does nothing
  // with the caller's executors.
  void Join() {
    if (threads_ == nullptr) return;
    threads_->slow.join();
    threads_->timers.join();
    scheduler_.Join();
    threads_->low_priority.join();
    threads_->images.join();
  }

 private:
  struct Threads {
    explicit Threads(int num_slow) : slow(static_cast<size_t>(num_slow)) {}
    Executors executors() {
      return {timers.get_executor(), slow.get_executor(), low_priority.get_executor(), images.get_executor()};
    }
    // A step that still runs may post work; it is dropped.
    void Stop() {
      for (boost::asio::thread_pool* pool : {&timers, &slow, &low_priority, &images}) {
        pool->stop();
        pool->join();
      }
    }

    boost::asio::thread_pool timers{1};
    boost::asio::thread_pool slow;
    boost::asio::thread_pool low_priority{1};
    boost::asio::thread_pool images{1};
  };

  const std::unique_ptr<Threads> threads_;  // null: the caller's executors are used
  const Executors on_;
  SlowExecutor slow_;
  SlowExecutor preparations_;
  SlowExecutor images_;
  FairScheduler scheduler_;  // is destroyed before the executors, to which its steps post
};

}  // namespace evpose::server
