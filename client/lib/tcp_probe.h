// SPDX-License-Identifier: Apache-2.0

// Connects to a server without gRPC, and describes why that fails. Internal.
#pragma once

#include <optional>
#include <string>

#include "absl/time/time.h"
#include "client/lib/server_address.h"

namespace evpose::client {

struct TcpFailure {
  std::string cause;
  std::string remedy;
};

// Returns a connected socket with `timeout` for each read and write, which the caller closes; -1 if no address of the
// host accepts a connection, with the failure of the last one. Blocks for up to `timeout` for each address.
int ConnectTcp(const ServerAddress& address, absl::Duration timeout, TcpFailure& failure);

// Returns why HOST:PORT accepts no connection; nullopt if it accepts one.
std::optional<TcpFailure> ExplainUnreachable(const std::string& address, absl::Duration timeout);

}  // namespace evpose::client
