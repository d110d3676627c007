// SPDX-License-Identifier: Apache-2.0

// Why a connection does not come about. gRPC says of every failed handshake that it failed; this makes one more, with
// OpenSSL's own functions, and says in words what was wrong. Internal.
#pragma once

#include <openssl/x509.h>

#include <string>

#include "absl/time/time.h"
#include "client/lib/client.h"

namespace evpose::client {

// What is wrong and what to do, empty when TLS is not to blame: nobody answers there, or all went well. Blocks for up
// to twice `timeout`.
std::string ExplainTls(const std::string& address, const TlsOptions& tls, absl::Duration timeout);

// The names and addresses that a certificate, whoever made it, is for: "localhost, 10.0.0.1", or "no host". What is no
// address is left out, control characters are escaped.
std::string HostsOf(const X509* certificate);

}  // namespace evpose::client
