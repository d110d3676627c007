// The threads that decode and track, shared by all sessions.
#pragma once

#include <boost/asio/post.hpp>
#include <boost/asio/strand.hpp>
#include <boost/asio/thread_pool.hpp>
#include <utility>

namespace evpose::server {

// Posts in order, never two at once.
using Strand = boost::asio::strand<boost::asio::thread_pool::executor_type>;

class WorkerPool {
 public:
  explicit WorkerPool(int num_threads) : pool_(static_cast<size_t>(num_threads)) {}

  template <typename Work>
  void Post(Work&& work) {
    boost::asio::post(pool_, std::forward<Work>(work));
  }
  Strand MakeStrand() { return boost::asio::make_strand(pool_.get_executor()); }
  boost::asio::thread_pool::executor_type executor() { return pool_.get_executor(); }

  // Returns when everything that was posted is done. Nothing may be posted afterwards.
  void Join() { pool_.join(); }

 private:
  boost::asio::thread_pool pool_;
};

}  // namespace evpose::server
