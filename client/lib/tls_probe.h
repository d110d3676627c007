// SPDX-License-Identifier: Apache-2.0

// Diagnoses failed TLS connections. gRPC reports every failed handshake in the same way; this module repeats the
// handshake with OpenSSL and describes the cause. Internal.
#pragma once

#include <openssl/x509.h>

#include <string>

#include "absl/time/time.h"
#include "evpose/client.h"

namespace evpose::client {

// Returns the cause and the remedy; empty if TLS is not the cause: no server responds, or the handshake succeeds.
// Blocks for up to twice `timeout`.
std::string ExplainTls(const std::string& address, const TlsOptions& tls, absl::Duration timeout);

// Returns the names and addresses of a certificate, whether or not it is trusted: "localhost, 10.0.0.1", or "no host".
// Invalid addresses are omitted, and control characters are escaped.
std::string HostsOf(const X509* certificate);

}  // namespace evpose::client
