// SPDX-License-Identifier: Apache-2.0
#include "server/http/load_listener.h"

#include <algorithm>
#include <boost/asio/buffer.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <cmath>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/connections/listen_address.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {
namespace {

using boost::asio::ip::tcp;

constexpr std::chrono::milliseconds kAcceptAgain(100);  // after an error

class AsioLoadListener : public LoadListener {
 public:
  explicit AsioLoadListener(std::function<std::string()> make_line) : make_line_(std::move(make_line)) {}
  ~AsioLoadListener() override {
    context_.stop();
    if (thread_.joinable()) thread_.join();
  }

  absl::Status Listen(const ListenAddress& address) {
    EVPOSE_ASSIGN_OR_RETURN(acceptors_, ListenOn(context_, address));
    port_ = acceptors_.front().local_endpoint().port();
    for (tcp::acceptor& acceptor : acceptors_) Accept(acceptor);
    thread_ = std::thread([this] {
      // A failed allocation ends its connection only.
      for (bool has_ended = false; !has_ended;) {
        RunUnlessOutOfMemory([this, &has_ended] {
          context_.run();
          has_ended = true;
        });
      }
    });
    return absl::OkStatus();
  }

  int port() const override { return port_; }

 private:
  void Accept(tcp::acceptor& acceptor) {
    acceptor.async_accept([this, &acceptor](const boost::system::error_code& error, tcp::socket socket) {
      if (error) {
        // In particular when no descriptor is free.
        const auto pause = std::make_shared<boost::asio::steady_timer>(context_, kAcceptAgain);
        pause->async_wait([this, &acceptor, pause](const boost::system::error_code&) { Accept(acceptor); });
        return;
      }
      Accept(acceptor);
      Answer(socket);
    });
  }

  // A new connection has room for the line, so that nothing waits for the client.
  void Answer(tcp::socket& socket) const {
    boost::system::error_code ignored;
    socket.non_blocking(true, ignored);
    const std::string line = make_line_();
    socket.write_some(boost::asio::buffer(line), ignored);
    socket.shutdown(tcp::socket::shutdown_send, ignored);
  }

  const std::function<std::string()> make_line_;
  boost::asio::io_context context_{1};
  std::vector<tcp::acceptor> acceptors_;
  int port_ = 0;
  std::thread thread_;
};

}  // namespace

std::string AgentLine(double load_ratio) {
  return absl::StrCat(std::clamp(std::lround(100.0 * (1.0 - load_ratio)), 1L, 100L), "%\n");
}

absl::StatusOr<std::unique_ptr<LoadListener>> LoadListener::Start(const std::string& listen_address,
                                                                  std::function<std::string()> make_line) {
  EVPOSE_ASSIGN_OR_RETURN(const ListenAddress address, ParseListenAddress(listen_address));
  auto listener = std::make_unique<AsioLoadListener>(std::move(make_line));
  EVPOSE_RETURN_IF_ERROR(listener->Listen(address));
  return listener;
}

}  // namespace evpose::server
