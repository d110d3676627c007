// SPDX-License-Identifier: Apache-2.0

// Addresses to listen on, written as HOST:PORT.
#pragma once

#include <string>

#include "absl/status/status.h"
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

// Resolves and binds the address for a moment, to find out why a server could not listen on it. Errors: UNAVAILABLE
// with cause and advice; OK when binding succeeds now.
absl::Status ProbeListenAddress(const ListenAddress& address);

}  // namespace evpose::server
