// SPDX-License-Identifier: Apache-2.0

// Connections to a server: keepalive, TLS, the caller's token. Internal: it includes gRPC's headers.
#pragma once

#include <grpcpp/channel.h>

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/lib/client.h"

namespace evpose::client {

// Neither waits for a connection nor makes one. Errors: INVALID_ARGUMENT for an address that is no HOST:PORT; those of
// reading the files of TLS, and of core/base/certificates.h; FAILED_PRECONDITION for a token that would travel in
// clear.
absl::StatusOr<std::shared_ptr<grpc::Channel>> MakeChannel(const std::string& address, const ClientOptions& options);

}  // namespace evpose::client
