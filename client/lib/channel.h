// SPDX-License-Identifier: Apache-2.0

// Connections to a server: keepalive, TLS, authentication token. Internal: it includes headers of gRPC.
#pragma once

#include <grpcpp/channel.h>

#include <memory>
#include <stop_token>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "evpose/client.h"

namespace evpose::client {

// Does not connect. Errors: INVALID_ARGUMENT for an address that is not HOST:PORT; those of reading the TLS files, and
// of core/base/certificates.h; FAILED_PRECONDITION for a token that would be sent unencrypted. `shares_connection`:
// channels of this process with the same address and options use one connection.
absl::StatusOr<std::shared_ptr<grpc::Channel>> MakeChannel(const std::string& address, const ClientOptions& options,
                                                           bool shares_connection = true);

// Connects a channel whose connection was lost, without a delay, and waits until it is connected, for at most `longest`
// or until `stop`. Returns whether it is. A call fails at once after an attempt to connect has failed, and gRPC
// only processes a connection while something waits for it, and otherwise every 5 s (interval of its backup poller).
bool ConnectNow(grpc::Channel& channel, absl::Duration longest, const std::stop_token& stop);

}  // namespace evpose::client
