// SPDX-License-Identifier: Apache-2.0
#include "server/http/listener_thread.h"

#include <utility>

#include "core/base/status_macros.h"
#include "server/connections/owned_descriptor.h"

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
  OwnedDescriptor owned(descriptor);
  Socket socket(context_);
  boost::system::error_code error;
  socket.assign(peer.protocol(), descriptor, error);
  if (error) return;
  owned.Release();  // the socket closes it
  on_connection_(std::move(socket));
}

}  // namespace evpose::server
