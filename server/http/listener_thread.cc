// SPDX-License-Identifier: Apache-2.0
#include "server/http/listener_thread.h"

#include <unistd.h>

#include <utility>

#include "absl/cleanup/cleanup.h"
#include "core/base/status_macros.h"

namespace evpose::server {

absl::Status ListenerThread::Listen(const ListenAddress& address) {
  EVPOSE_ASSIGN_OR_RETURN(acceptors_, ListenOn(context_, address));
  port_ = acceptors_.front().local_endpoint().port();
  accept_loop_.Start(acceptors_);
  thread_ = std::thread([this] { accept_loop_.Run(); });
  return absl::OkStatus();
}

void ListenerThread::Stop() {
  context_.stop();
  if (thread_.joinable()) thread_.join();
}

void ListenerThread::Take(int descriptor, const boost::asio::ip::tcp::endpoint& peer) {
  absl::Cleanup closing = [descriptor] { close(descriptor); };  // also when an allocation fails
  Socket socket(context_);
  boost::system::error_code error;
  socket.assign(peer.protocol(), descriptor, error);
  if (error) return;
  std::move(closing).Cancel();
  on_connection_(std::move(socket));
}

}  // namespace evpose::server
