// SPDX-License-Identifier: Apache-2.0
#include "server/connections/accept_loop.h"

#include <sys/socket.h>

#include <boost/asio/steady_timer.hpp>
#include <cerrno>
#include <chrono>
#include <memory>

#include "server/runtime/out_of_memory.h"

namespace evpose::server {
namespace {

using boost::asio::ip::tcp;

constexpr int kConnectionsPerTurn = 64;  // between them, the thread looks at the other listeners and at its timers
constexpr std::chrono::milliseconds kPause(100);  // until accept() is tried again after an error

}  // namespace

void AcceptLoop::Start(std::vector<tcp::acceptor>& acceptors) {
  for (tcp::acceptor& acceptor : acceptors) Await(acceptor);
}

void AcceptLoop::Run() {
  for (bool has_ended = false; !has_ended;) {
    RunUnlessOutOfMemory([this, &has_ended] {
      context_.run();
      has_ended = true;
    });
  }
}

void AcceptLoop::Await(tcp::acceptor& acceptor) {
  acceptor.async_wait(tcp::acceptor::wait_read, [this, &acceptor](const boost::system::error_code& error) {
    if (error) return;
    bool is_paused = true;
    RunUnlessOutOfMemory([&] { is_paused = !AcceptWaiting(acceptor); });
    if (!is_paused) return Await(acceptor);
    // Without memory for the pause, the wait follows at once; Asio reuses the memory of this handler for it.
    RunUnlessOutOfMemory([&] {
      AwaitAfterPause(acceptor);
      is_paused = false;
    });
    if (is_paused) Await(acceptor);
  });
}

void AcceptLoop::AwaitAfterPause(tcp::acceptor& acceptor) {
  const auto pause = std::make_shared<boost::asio::steady_timer>(context_, kPause);
  pause->async_wait([this, &acceptor, pause](const boost::system::error_code&) { Await(acceptor); });
}

bool AcceptLoop::AcceptWaiting(tcp::acceptor& acceptor) {
  for (int i = 0; i < kConnectionsPerTurn; ++i) {
    tcp::endpoint peer;
    auto length = static_cast<socklen_t>(peer.capacity());
    const int descriptor = accept4(acceptor.native_handle(), peer.data(), &length, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (descriptor >= 0) {
      peer.resize(length);
      callbacks_.take(descriptor, peer);
      continue;
    }
    if (errno == EAGAIN) break;
    if (errno == EINTR || errno == ECONNABORTED) continue;
    if (errno == EMFILE || errno == ENFILE) callbacks_.on_no_descriptor();
    return false;
  }
  return true;
}

}  // namespace evpose::server
