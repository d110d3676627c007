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

// Starts a connection attempt of `channel` without gRPC's reconnect delay. Blocks until the channel is connected,
// `longest` has passed or a stop is requested, and returns whether the channel is connected. After a failed attempt a
// call does not wait for the next one, and gRPC processes an attempt only while a thread waits for the channel, and
// otherwise every 5 s (interval of its backup poller).
bool ConnectNow(grpc::Channel& channel, absl::Duration longest, const std::stop_token& stop);

}  // namespace evpose::client
