// SPDX-License-Identifier: Apache-2.0

// Checks that a listener accepts connections, by connecting to it.
#pragma once

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <cstdint>
#include <optional>

namespace evpose::server {

class ListenerCheck {
 public:
  enum class State {
    kAccepts,
    kSilent,   // the connection of the previous step has not been accepted
    kStalled,  // no connection has been accepted for kStepsToStall steps
  };
  // With several steps, a single connection that a busy machine delays does not count as a stall; more steps shorten
  // the time that each connection has (ConnectionAcceptor::Options::listener_timeout is divided by their number).
  static constexpr int kStepsToStall = 4;

  // `listener` is the local address of the listener. A wildcard address accepts connections to 127.0.0.1.
  explicit ListenerCheck(const boost::asio::ip::tcp::endpoint& listener);

  // Determines the state from the number of connections that the listener has accepted so far, and connects again. Does
  // not block. To be called periodically. A connection that this process cannot make says nothing about the listener:
  // kAccepts.
  State Step(uint64_t num_accepted);
  // True for the present connection of the check. Thread-safe.
  bool IsMine(const boost::asio::ip::tcp::endpoint& peer) const;

 private:
  void Connect();

  const boost::asio::ip::tcp::endpoint listener_;
  boost::asio::io_context context_;
  std::optional<boost::asio::ip::tcp::socket> connection_;
  std::atomic<uint16_t> local_port_ = 0;
  uint64_t num_accepted_ = 0;
  int num_silent_steps_ = 0;
};

}  // namespace evpose::server
