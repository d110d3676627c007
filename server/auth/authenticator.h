// SPDX-License-Identifier: Apache-2.0

// Determines the caller of a call. Without gRPC types: server/rpc/common/authentication.h extracts the credentials from
// a call.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "core/base/certificates.h"
#include "server/auth/caller.h"
#include "server/auth/revocation_file.h"
#include "server/auth/token_file.h"
#include "server/telemetry/log_limiter.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

// The credentials of a call. The views are valid as long as the call.
struct CallCredentials {
  std::vector<absl::string_view> authorization;  // all values of the metadata `authorization`
  absl::string_view certificate_pem;             // the client's, whose chain TLS has verified; empty: none
  absl::string_view peer;                        // address of the client
};

// The circumstances of a check of an open stream.
struct AccessCheck {
  absl::Time now;
  uint64_t version = 0;  // Authenticator::version()
};

// Thread-safe.
class Authenticator {
 public:
  struct Options {
    std::string token_file;  // empty: no tokens
    // Clients must present a certificate. Without a token file its CN is the tenant.
    bool has_client_certificates = false;
    std::string revocations;  // file of revocation lists for client certificates; empty: none
    std::shared_ptr<ServerMetrics> metrics = std::make_shared<ServerMetrics>();
    std::function<absl::Time()> now = absl::Now;  // for the validity of certificates
  };
  // Errors: those of TokenFile::Open and OpenRevocationFile.
  static absl::StatusOr<std::unique_ptr<Authenticator>> Create(const Options& options);

  // Returns the caller. Without tokens and client certificates, every caller is the tenant "" and an operator. Failures
  // are counted, and logged at a limited rate. Errors: UNAUTHENTICATED (NO_TOKEN, BAD_TOKEN, BAD_CERTIFICATE).
  absl::StatusOr<Caller> Authenticate(const CallCredentials& credentials);

  // Increases whenever the tokens or the revocations change.
  uint64_t version() const;
  AccessCheck BeginCheck() const { return {options_.now(), version()}; }

  // True if neither tokens nor client certificates are configured.
  bool is_open() const { return tokens_ == nullptr && !options_.has_client_certificates; }
  // The number of valid tokens; nullopt: no tokens are configured.
  std::optional<size_t> num_tokens() const;

 private:
  explicit Authenticator(const Options& options) : options_(options) {}
  // Locks at the end of the creation and before the first use by a thread: ThreadSanitizer does not see the order of
  // the threads of gRPC.
  void OrderAfterCreation() const { const std::lock_guard lock(creation_); }
  absl::StatusOr<Caller> CallerOf(const CallCredentials& credentials) const;
  absl::StatusOr<Caller> CallerOfToken(const std::vector<absl::string_view>& authorization) const;
  absl::StatusOr<ClientCertificate> CheckCertificate(absl::string_view pem) const;
  void ReportFailure(const absl::Status& status, absl::string_view peer);

  const Options options_;
  std::unique_ptr<TokenFile> tokens_;            // null: no tokens
  std::unique_ptr<RevocationFile> revocations_;  // null: none
  LogLimiter limiter_;
  mutable std::mutex creation_;
};

}  // namespace evpose::server
