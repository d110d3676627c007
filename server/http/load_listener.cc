// SPDX-License-Identifier: Apache-2.0
#include "server/http/load_listener.h"

#include <algorithm>
#include <boost/asio/buffer.hpp>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/connections/listen_address.h"
#include "server/http/listener_thread.h"

namespace evpose::server {
namespace {

class TcpLoadListener : public LoadListener {
 public:
  explicit TcpLoadListener(std::function<std::string()> make_line) : make_line_(std::move(make_line)) {}

  absl::Status Listen(const ListenAddress& address) { return listener_.Listen(address); }

  int port() const override { return listener_.port(); }

 private:
  // A new connection has room for the line, so that nothing waits for the client.
  void Answer(ListenerThread::Socket socket) const {
    boost::system::error_code ignored;
    socket.non_blocking(true, ignored);
    const std::string line = make_line_();
    socket.write_some(boost::asio::buffer(line), ignored);
    socket.shutdown(boost::asio::ip::tcp::socket::shutdown_send, ignored);
  }

  const std::function<std::string()> make_line_;
  ListenerThread listener_{[this](ListenerThread::Socket socket) { Answer(std::move(socket)); }};
};

}  // namespace

std::string AgentLine(double load_ratio) {
  return absl::StrCat(std::clamp(std::lround(100.0 * (1.0 - load_ratio)), 1L, 100L), "%\n");
}

absl::StatusOr<std::unique_ptr<LoadListener>> LoadListener::Start(const std::string& listen_address,
                                                                  std::function<std::string()> make_line) {
  EVPOSE_ASSIGN_OR_RETURN(const ListenAddress address, ParseListenAddress(listen_address));
  auto listener = std::make_unique<TcpLoadListener>(std::move(make_line));
  EVPOSE_RETURN_IF_ERROR(listener->Listen(address));
  return listener;
}

}  // namespace evpose::server
