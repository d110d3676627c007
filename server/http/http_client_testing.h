// SPDX-License-Identifier: Apache-2.0

// A minimal HTTP client for tests.
#pragma once

#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/address.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/write.hpp>
#include <memory>
#include <string>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "core/base/poll_testing.h"

namespace evpose::server {

// One connection to a port of this machine.
class HttpConnection {
 public:
  // `from`: the address of the client, in the network of loopback.
  explicit HttpConnection(int port, const char* from = "127.0.0.1") {
    socket_.open(boost::asio::ip::tcp::v4());
    socket_.bind({boost::asio::ip::make_address(from), 0});
    socket_.connect({boost::asio::ip::address_v4::loopback(), static_cast<uint16_t>(port)});
  }
  // Errors are ignored, because the server may close the connection before it has read everything.
  void Write(const std::string& bytes) {
    boost::system::error_code ignored;
    boost::asio::write(socket_, boost::asio::buffer(bytes), ignored);
  }
  // Reads until the server closes the connection.
  std::string ReadAll() {
    constexpr int kPatienceMs = 60'000;
    std::string bytes;
    for (char piece[4096];;) {
      pollfd waiting = {.fd = socket_.native_handle(), .events = POLLIN, .revents = 0};
      if (poll(&waiting, 1, kPatienceMs) != 1) {
        ADD_FAILURE() << "the server does not respond";
        return bytes;
      }
      const ssize_t size = recv(socket_.native_handle(), piece, sizeof(piece), 0);
      if (size <= 0) return bytes;
      bytes.append(piece, static_cast<size_t>(size));
    }
  }

 private:
  boost::asio::io_context context_;
  boost::asio::ip::tcp::socket socket_{context_};
};

struct HttpResponse {
  int status = 0;
  std::string head;
  std::string body;
};

// Sends one request and returns the response. Each line of `headers` ends with CR LF.
inline HttpResponse Ask(int port, const std::string& path, const std::string& method = "GET",
                        const std::string& sent_body = "", const std::string& headers = "") {
  HttpConnection connection(port);
  connection.Write(absl::StrCat(method, " ", path, " HTTP/1.1\r\nHost: test\r\n", headers,
                                "Content-Length: ", sent_body.size(), "\r\n\r\n", sent_body));
  const std::string bytes = connection.ReadAll();
  HttpResponse answer;
  const size_t end = bytes.find("\r\n\r\n");
  if (end == std::string::npos || !absl::SimpleAtoi(bytes.substr(std::string("HTTP/1.1 ").size(), 3), &answer.status)) {
    ADD_FAILURE() << "not an HTTP response: " << bytes;
    return answer;
  }
  answer.head = bytes.substr(0, end + 2);
  answer.body = bytes.substr(end + 4);
  return answer;
}

// Waits until /readyz has this status, and returns that response.
inline HttpResponse WaitUntilReadyIs(int port, int status) {
  HttpResponse answer;
  EXPECT_TRUE(Poll([&] {
    answer = Ask(port, "/readyz");
    return answer.status == status;
  })) << "status "
      << answer.status << ": " << answer.body;
  return answer;
}

}  // namespace evpose::server
