// SPDX-License-Identifier: Apache-2.0
#include "server/http/listener_thread.h"

#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <memory>
#include <utility>

#include "core/base/status_macros.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {
namespace {

constexpr std::chrono::milliseconds kPause(100);  // until accept() is tried again after an error

}  // namespace

absl::Status ListenerThread::Listen(const ListenAddress& address) {
  EVPOSE_ASSIGN_OR_RETURN(acceptors_, ListenOn(context_, address));
  port_ = acceptors_.front().local_endpoint().port();
  for (boost::asio::ip::tcp::acceptor& acceptor : acceptors_) Accept(acceptor);
  thread_ = std::thread([this] { Run(); });
  return absl::OkStatus();
}

void ListenerThread::Stop() {
  context_.stop();
  if (thread_.joinable()) thread_.join();
}

void ListenerThread::Run() {
  // A failed allocation ends its connection only.
  for (bool has_ended = false; !has_ended;) {
    RunUnlessOutOfMemory([this, &has_ended] {
      context_.run();
      has_ended = true;
    });
  }
}

void ListenerThread::Accept(boost::asio::ip::tcp::acceptor& acceptor) {
  acceptor.async_accept([this, &acceptor](const boost::system::error_code& error, Socket socket) {
    if (error) return AcceptAfterPause(acceptor);
    Accept(acceptor);
    on_connection_(std::move(socket));
  });
}

// Continues after an error, in particular when no descriptor is free.
void ListenerThread::AcceptAfterPause(boost::asio::ip::tcp::acceptor& acceptor) {
  const auto pause = std::make_shared<boost::asio::steady_timer>(context_, kPause);
  pause->async_wait([this, &acceptor, pause](const boost::system::error_code&) { Accept(acceptor); });
}

}  // namespace evpose::server
