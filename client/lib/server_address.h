// SPDX-License-Identifier: Apache-2.0

// HOST:PORT, as users write it. Internal.
#pragma once

#include <string>

#include "absl/status/statusor.h"

namespace evpose::client {

struct ServerAddress {
  std::string host;  // without the brackets of an IPv6 address
  int port = 0;

  // Whether what is sent there stays on this machine.
  bool IsLoopback() const;
};

// Errors: INVALID_ARGUMENT.
absl::StatusOr<ServerAddress> ParseServerAddress(const std::string& text);

}  // namespace evpose::client
