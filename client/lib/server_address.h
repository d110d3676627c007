// SPDX-License-Identifier: Apache-2.0

// Parses HOST:PORT. Internal.
#pragma once

#include <string>

#include "absl/status/statusor.h"

namespace evpose::client {

struct ServerAddress {
  std::string host;  // without the brackets of an IPv6 address
  int port = 0;

  // Returns whether data for this address stays on this machine.
  bool IsLoopback() const;
};

// Error: INVALID_ARGUMENT.
absl::StatusOr<ServerAddress> ParseServerAddress(const std::string& text);

}  // namespace evpose::client
