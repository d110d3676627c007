// SPDX-License-Identifier: Apache-2.0

// Determines the caller of a call. Without gRPC types: server/rpc/authentication.h extracts the credentials from a
// call.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/auth/caller.h"
#include "server/auth/token_file.h"

namespace evpose::server {

// The credentials of a call. The views are valid as long as the call.
struct CallCredentials {
  std::vector<absl::string_view> authorization;  // all values of the metadata `authorization`
  // CN of the client's certificate, which TLS has verified.
  std::optional<absl::string_view> certificate_name;
};

// Thread-safe.
class Authenticator {
 public:
  struct Options {
    std::string token_file;  // empty: no tokens
    // Clients must present a certificate. Without a token file its CN is the tenant.
    bool has_client_certificates = false;
  };
  // Errors: those of TokenFile::Open.
  static absl::StatusOr<std::unique_ptr<Authenticator>> Create(const Options& options);

  // Returns the caller without `peer`. Without tokens and client certificates, every caller is the tenant "" and an
  // operator. Errors: UNAUTHENTICATED (NO_TOKEN, BAD_TOKEN, BAD_CERTIFICATE).
  absl::StatusOr<Caller> Authenticate(const CallCredentials& credentials);

  // True if neither tokens nor client certificates are configured.
  bool is_open() const { return tokens_ == nullptr && !has_client_certificates_; }

 private:
  Authenticator() = default;
  absl::StatusOr<Caller> CallerOfToken(const std::vector<absl::string_view>& authorization);

  std::unique_ptr<TokenFile> tokens_;
  bool has_client_certificates_ = false;
};

}  // namespace evpose::server
