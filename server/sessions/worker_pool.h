// The threads that decode and track, shared by all sessions, and two for what must not take their place.
#pragma once

#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/strand.hpp>
#include <boost/asio/thread_pool.hpp>
#include <memory>
#include <utility>

#include "absl/time/time.h"

namespace evpose::server {

// Posts in order, never two at once. Between two of its own, what others have posted to the pool has its turn.
using Strand = boost::asio::strand<boost::asio::thread_pool::executor_type>;

using PoolTimer = boost::asio::steady_timer;

// Outlives the sessions and their store, whose thread may be the last to let go of a session: its strand and its timers
// belong to the pool.
class WorkerPool {
 public:
  explicit WorkerPool(int num_threads) : pool_(static_cast<size_t>(num_threads)), slow_(1), aside_(1) {}

  template <typename Work>
  void Post(Work&& work) {
    boost::asio::post(pool_, std::forward<Work>(work));
  }
  // After `delay`, unless the timer is destroyed or cancelled before.
  template <typename Work>
  std::unique_ptr<PoolTimer> PostAfter(absl::Duration delay, Work&& work) {
    auto timer = std::make_unique<PoolTimer>(pool_, absl::ToChronoNanoseconds(delay));
    timer->async_wait([work = std::forward<Work>(work)](const boost::system::error_code& error) mutable {
      if (!error) work();
    });
    return timer;
  }
  // For what takes seconds: loading models, making trackers. One after the other.
  template <typename Work>
  void PostSlow(Work&& work) {
    boost::asio::post(slow_, std::forward<Work>(work));
  }
  // For what is short, but much: telling the watchers.
  template <typename Work>
  void PostAside(Work&& work) {
    boost::asio::post(aside_, std::forward<Work>(work));
  }
  Strand MakeStrand() { return boost::asio::make_strand(pool_.get_executor()); }
  boost::asio::thread_pool::executor_type executor() { return pool_.get_executor(); }

  // Returns when everything that was posted is done. Nothing may be posted afterwards.
  void Join() {
    slow_.join();
    pool_.join();
    aside_.join();
  }

 private:
  boost::asio::thread_pool pool_;
  boost::asio::thread_pool slow_;
  boost::asio::thread_pool aside_;
};

}  // namespace evpose::server
