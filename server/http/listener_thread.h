// SPDX-License-Identifier: Apache-2.0

// Accepts connections in a thread of its own.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <functional>
#include <thread>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "server/connections/accept_loop.h"
#include "server/connections/listen_address.h"

namespace evpose::server {

class ListenerThread {
 public:
  using Socket = boost::asio::ip::tcp::socket;

  // `on_connection` is called in the thread and must not block. A failed allocation in it ends this connection only.
  explicit ListenerThread(std::function<void(Socket)> on_connection) : on_connection_(std::move(on_connection)) {}
  ~ListenerThread() { Stop(); }

  // Called once. Errors: UNAVAILABLE, with cause and remedy.
  absl::Status Listen(const ListenAddress& address);
  int port() const { return port_; }
  // Afterwards `on_connection` and the handlers of the sockets are not called. Connections must be destroyed before
  // this object.
  void Stop();

 private:
  void Take(int descriptor, const boost::asio::ip::tcp::endpoint& peer);

  const std::function<void(Socket)> on_connection_;
  boost::asio::io_context context_{1};
  AcceptLoop accept_loop_{context_, {.take = [this](int descriptor, const auto& peer) { Take(descriptor, peer); }}};
  std::vector<boost::asio::ip::tcp::acceptor> acceptors_;
  int port_ = 0;
  std::thread thread_;
};

}  // namespace evpose::server
