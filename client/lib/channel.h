// SPDX-License-Identifier: Apache-2.0

// Connections to a server: keepalive, TLS, authentication token. Internal: it includes headers of gRPC.
#pragma once

#include <grpcpp/channel.h>

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "evpose/client.h"

namespace evpose::client {

// Does not connect. Errors: INVALID_ARGUMENT for an address that is not HOST:PORT; those of reading the TLS files, and
// of core/base/certificates.h; FAILED_PRECONDITION for a token that would be sent unencrypted. `shares_connection`:
// channels of this process with the same address and options use one connection.
absl::StatusOr<std::shared_ptr<grpc::Channel>> MakeChannel(const std::string& address, const ClientOptions& options,
                                                           bool shares_connection = true);

}  // namespace evpose::client
