// SPDX-License-Identifier: Apache-2.0

// A minimal HTTP client for tests.
#pragma once

#include <gtest/gtest.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/address.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/read.hpp>
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
  std::string ReadAll() {
    std::string bytes;
    boost::system::error_code ignored;
    boost::asio::read(socket_, boost::asio::dynamic_buffer(bytes), ignored);
    return bytes;
  }

 private:
  boost::asio::io_context context_;
  boost::asio::ip::tcp::socket socket_{context_};
};

struct HttpAnswer {
  int status = 0;
  std::string head;
  std::string body;
};

// Sends one request and returns the response. Each line of `headers` ends with CR LF.
inline HttpAnswer Ask(int port, const std::string& path, const std::string& method = "GET",
                      const std::string& sent_body = "", const std::string& headers = "") {
  HttpConnection connection(port);
  connection.Write(absl::StrCat(method, " ", path, " HTTP/1.1\r\nHost: test\r\n", headers,
                                "Content-Length: ", sent_body.size(), "\r\n\r\n", sent_body));
  const std::string bytes = connection.ReadAll();
  HttpAnswer answer;
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
inline HttpAnswer WaitUntilReadyIs(int port, int status) {
  HttpAnswer answer;
  EXPECT_TRUE(Poll([&] {
    answer = Ask(port, "/readyz");
    return answer.status == status;
  })) << "status "
      << answer.status << ": " << answer.body;
  return answer;
}

}  // namespace evpose::server
