// SPDX-License-Identifier: Apache-2.0

// TLS for a gRPC server. The one file of server/auth that sees gRPC.
#pragma once

#include <grpcpp/security/server_credentials.h>

#include <memory>

#include "server/auth/tls_files.h"

namespace evpose::server {

// Asks `files` at every handshake, so that a new connection sees a new certificate and those that stand go on. Must
// outlive the server.
//
// grpc::experimental::FileWatcherCertificateProvider would poll, and hand a key and a certificate that do not match, or
// half a file, to the handshakes that follow.
std::shared_ptr<grpc::ServerCredentials> MakeTlsServerCredentials(std::unique_ptr<TlsFiles> files,
                                                                  bool has_client_certificates);

}  // namespace evpose::server
