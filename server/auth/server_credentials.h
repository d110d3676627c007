// SPDX-License-Identifier: Apache-2.0

// TLS credentials of a gRPC server. The only file of server/auth that uses gRPC.
#pragma once

#include <grpcpp/security/server_credentials.h>

#include <memory>

#include "server/auth/tls_files.h"

namespace evpose::server {

// Reads `files` at every handshake: new connections get a renewed certificate, and existing connections continue. The
// result must outlive the server.
//
// grpc::experimental::FileWatcherCertificateProvider is not used, because it polls, and because a mismatch of key and
// certificate or a partly written file would break later handshakes.
std::shared_ptr<grpc::ServerCredentials> MakeTlsServerCredentials(std::unique_ptr<TlsFiles> files,
                                                                  bool has_client_certificates);

}  // namespace evpose::server
