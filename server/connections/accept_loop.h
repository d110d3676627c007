// SPDX-License-Identifier: Apache-2.0

// Accepts the connections of listening sockets for as long as the process lives: neither an error, such as a shortage
// of descriptors, nor a failed allocation ends it. (The functions async_accept() of Asio that return a socket allocate
// before their handler runs; if that fails, they accept nothing more.)
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <functional>
#include <utility>
#include <vector>

namespace evpose::server {

class AcceptLoop {
 public:
  struct Callbacks {
    // Receives the non-blocking descriptor of each connection and owns it, also if an allocation fails in it.
    std::function<void(int descriptor, const boost::asio::ip::tcp::endpoint& peer)> take;
    // Called when a connection waits because the process has no descriptor for it. Accepting is tried again later.
    std::function<void()> on_no_descriptor = [] {};
  };
  // Everything runs on the thread that calls Run(). `context` outlives this object.
  AcceptLoop(boost::asio::io_context& context, Callbacks callbacks)
      : context_(context), callbacks_(std::move(callbacks)) {}

  // The acceptors do not block, and outlive Run().
  void Start(std::vector<boost::asio::ip::tcp::acceptor>& acceptors);
  // Returns after `context.stop()`. A failed allocation ends the handler that made it, and so its connection only.
  void Run();

 private:
  void Await(boost::asio::ip::tcp::acceptor& acceptor);
  void AwaitAfterPause(boost::asio::ip::tcp::acceptor& acceptor);
  // Returns false after an error, after which accept() is tried again later.
  bool AcceptWaiting(boost::asio::ip::tcp::acceptor& acceptor);

  boost::asio::io_context& context_;
  const Callbacks callbacks_;
};

}  // namespace evpose::server
