// SPDX-License-Identifier: Apache-2.0

// The threads that decode and track, shared by all sessions, and two for what must not take their place.
#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/strand.hpp>
#include <boost/asio/thread_pool.hpp>
#include <memory>
#include <utility>

#include "absl/time/time.h"

namespace evpose::server {

// Posts in order, never two at once. Between two of its own, what others have posted to the pool has its turn.
using Strand = boost::asio::strand<boost::asio::any_io_executor>;

using PoolTimer = boost::asio::steady_timer;

// Outlives the sessions and their store, whose thread may be the last to let go of a session: its strand and its timers
// belong to the pool.
class WorkerPool {
 public:
  // Who runs what is posted.
  struct Executors {
    boost::asio::any_io_executor work;
    boost::asio::any_io_executor slow;
    boost::asio::any_io_executor aside;
  };

  explicit WorkerPool(int num_threads) : threads_(std::make_unique<Threads>(num_threads)), on_(threads_->executors()) {}
  // On threads of the caller's, who keeps what runs there beyond this.
  explicit WorkerPool(Executors executors) : on_(std::move(executors)) {}

  template <typename Work>
  void Post(Work&& work) {
    boost::asio::post(on_.work, std::forward<Work>(work));
  }
  // After `delay`, unless the timer is destroyed or cancelled before.
  template <typename Work>
  std::unique_ptr<PoolTimer> PostAfter(absl::Duration delay, Work&& work) {
    auto timer = std::make_unique<PoolTimer>(on_.work, absl::ToChronoNanoseconds(delay));
    timer->async_wait([work = std::forward<Work>(work)](const boost::system::error_code& error) mutable {
      if (!error) work();
    });
    return timer;
  }
  // For what takes seconds: loading models, making trackers. One after the other.
  template <typename Work>
  void PostSlow(Work&& work) {
    boost::asio::post(on_.slow, std::forward<Work>(work));
  }
  // For what is short, but much: telling the watchers.
  template <typename Work>
  void PostAside(Work&& work) {
    boost::asio::post(on_.aside, std::forward<Work>(work));
  }
  Strand MakeStrand() { return Strand(on_.work); }
  const boost::asio::any_io_executor& executor() { return on_.work; }

  // Returns when everything that was posted to the pool's own threads is done. Nothing may be posted afterwards.
  void Join() {
    if (threads_ != nullptr) threads_->Join();
  }

 private:
  struct Threads {
    explicit Threads(int num_threads) : work(static_cast<size_t>(num_threads)), slow(1), aside(1) {}
    Executors executors() { return {work.get_executor(), slow.get_executor(), aside.get_executor()}; }
    void Join() {
      slow.join();
      work.join();
      aside.join();
    }

    boost::asio::thread_pool work;
    boost::asio::thread_pool slow;
    boost::asio::thread_pool aside;
  };

  const std::unique_ptr<Threads> threads_;  // null: the caller's
  const Executors on_;
};

}  // namespace evpose::server
