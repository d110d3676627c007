// SPDX-License-Identifier: Apache-2.0

// Addresses to listen on, written as HOST:PORT.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace evpose::server {

struct ListenAddress {
  std::string host;  // without the brackets of an IPv6 address
  int port = 0;

  std::string WithPort(int actual_port) const;  // HOST:PORT, with brackets around an IPv6 address
  // True if only processes of this machine can reach the address.
  bool IsLoopback() const;
};

// Parses HOST:PORT or [IPV6]:PORT. Errors: INVALID_ARGUMENT with the part that is wrong.
absl::StatusOr<ListenAddress> ParseListenAddress(const std::string& text);

// Listens on the address, without blocking calls and with TCP_NODELAY for all accepted connections. A name is resolved;
// all its addresses get the same port, and one that cannot be used is skipped if another can. A wildcard address,
// 0.0.0.0 or [::], accepts IPv4 and IPv6 where the machine has both. Returns at least one acceptor. Errors: UNAVAILABLE
// with cause and advice.
absl::StatusOr<std::vector<boost::asio::ip::tcp::acceptor>> ListenOn(boost::asio::io_context& context,
                                                                     const ListenAddress& address);

}  // namespace evpose::server
