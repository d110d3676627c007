// SPDX-License-Identifier: Apache-2.0
#include "server/connections/listener_check.h"

#include <sys/socket.h>

#include <cerrno>

#include "server/connections/unmapped_address.h"

namespace evpose::server {
namespace {

namespace ip = boost::asio::ip;

ip::tcp::endpoint Reachable(const ip::tcp::endpoint& listener) {
  if (!listener.address().is_unspecified()) return listener;
  return {ip::address_v4::loopback(), listener.port()};
}

}  // namespace

ListenerCheck::ListenerCheck(const ip::tcp::endpoint& listener) : listener_(Reachable(listener)) {}

ListenerCheck::State ListenerCheck::Step(uint64_t num_accepted) {
  const bool is_silent = connection_.has_value() && num_accepted == num_accepted_;
  num_silent_steps_ = is_silent ? num_silent_steps_ + 1 : 0;
  num_accepted_ = num_accepted;
  Connect();
  if (!is_silent) return State::kAccepts;
  return num_silent_steps_ < kStepsToStall ? State::kSilent : State::kStalled;
}

bool ListenerCheck::IsMine(const ip::tcp::endpoint& peer) const {
  return peer.port() == local_port_ && Unmapped(peer.address()) == listener_.address();
}

void ListenerCheck::Connect() {
  boost::system::error_code error;
  connection_.emplace(context_);
  connection_->open(listener_.protocol(), error);
  // Bound before it connects, because the listener may accept the connection before connect() has returned.
  if (!error) connection_->bind({listener_.address(), 0}, error);
  if (!error) connection_->native_non_blocking(true, error);
  if (!error) local_port_ = connection_->local_endpoint(error).port();
  // Asio's connect() would wait for a listener whose backlog is full.
  const bool is_begun = !error && (::connect(connection_->native_handle(), listener_.data(),
                                             static_cast<socklen_t>(listener_.size())) == 0 ||
                                   errno == EINPROGRESS || errno == ECONNREFUSED);
  if (!is_begun) connection_.reset();
}

}  // namespace evpose::server
