// SPDX-License-Identifier: Apache-2.0

// HOST:PORT, as users write it.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace evpose::server {

struct ListenAddress {
  std::string host;  // without the brackets of an IPv6 address
  int port = 0;

  std::string WithPort(int actual_port) const;  // HOST:PORT again, brackets included
  // Whether only this machine can reach it.
  bool IsLoopback() const;
};

// Errors: INVALID_ARGUMENT naming what is wrong.
absl::StatusOr<ListenAddress> ParseListenAddress(const std::string& text);

// Why nobody can listen there: resolves and binds it for a moment. OK when it could be done now.
absl::Status ProbeListenAddress(const ListenAddress& address);

}  // namespace evpose::server
