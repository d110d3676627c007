// SPDX-License-Identifier: Apache-2.0
#include "server/auth/authenticator.h"

#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/runtime/errors.h"
#include "server/telemetry/log.h"

namespace evpose::server {
namespace {

constexpr absl::string_view kScheme = "Bearer ";

absl::Status Unauthenticated(v1::ErrorReason reason, absl::string_view message) {
  return WithReason(absl::UnauthenticatedError(message), reason);
}

absl::Status BadCertificate(absl::string_view message) { return Unauthenticated(v1::BAD_CERTIFICATE, message); }

absl::StatusOr<Caller> CallerOfCertificate(const ClientCertificate& certificate) {
  if (certificate.common_names.size() != 1) {
    return BadCertificate(absl::StrCat("the client's certificate has ", certificate.common_names.size(),
                                       " common names (CN); exactly one must name the tenant"));
  }
  const std::string& name = certificate.common_names.front();
  if (const absl::Status status = ValidateTenant(name); !status.ok()) {
    return BadCertificate(absl::StrCat("the certificate's CN: ", status.message()));
  }
  return Caller{name, false};
}

}  // namespace

absl::StatusOr<std::unique_ptr<Authenticator>> Authenticator::Create(const Options& options) {
  std::unique_ptr<Authenticator> authenticator(new Authenticator(options));
  if (!options.token_file.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(authenticator->tokens_, TokenFile::Open(options.token_file));
  }
  if (!options.revocations.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(authenticator->revocations_, OpenRevocationFile(options.revocations));
  }
  authenticator->OrderAfterCreation();
  return authenticator;
}

uint64_t Authenticator::version() const {
  OrderAfterCreation();
  return (tokens_ == nullptr ? 0 : tokens_->version()) + (revocations_ == nullptr ? 0 : revocations_->version());
}

std::optional<size_t> Authenticator::num_tokens() const {
  if (tokens_ == nullptr) return std::nullopt;
  return tokens_->size();
}

absl::StatusOr<Caller> Authenticator::Authenticate(const CallCredentials& credentials) {
  absl::StatusOr<Caller> caller = CallerOf(credentials);
  if (caller.ok()) {
    caller->peer = std::string(credentials.peer);
  } else {
    ReportFailure(caller.status(), credentials.peer);
  }
  return caller;
}

absl::StatusOr<Caller> Authenticator::CallerOf(const CallCredentials& credentials) const {
  OrderAfterCreation();
  if (is_open()) return Caller{"", true};
  ClientCertificate certificate = {.common_names = {}, .not_after = absl::InfiniteFuture(), .key = ""};
  // TLS requires a certificate. A call on the in-process channel has none; a token is enough for it.
  if (!credentials.certificate_pem.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(certificate, CheckCertificate(credentials.certificate_pem));
  }
  EVPOSE_ASSIGN_OR_RETURN(
      Caller caller, tokens_ != nullptr ? CallerOfToken(credentials.authorization) : CallerOfCertificate(certificate));
  caller.expires = certificate.not_after;
  return caller;
}

// TLS has verified the certificate when the connection was made, which may be days ago.
absl::StatusOr<ClientCertificate> Authenticator::CheckCertificate(absl::string_view pem) const {
  auto certificate = ReadClientCertificate({"the client's certificate", std::string(pem)});
  if (!certificate.ok()) return BadCertificate(certificate.status().message());
  if (options_.now() >= certificate->not_after) {
    return BadCertificate("the client's certificate has expired: connect with a renewed one");
  }
  if (revocations_ != nullptr && revocations_->Current()->keys.contains(certificate->key)) {
    return BadCertificate("the client's certificate was revoked: ask the server's operator for another one");
  }
  return certificate;
}

void Authenticator::ReportFailure(const absl::Status& status, absl::string_view peer) {
  const std::string reason = GetErrorDetails(status).reason;
  const AuthenticationFailure kind = reason == v1::ErrorReason_Name(v1::NO_TOKEN) ? AuthenticationFailure::kNoToken
                                     : reason == v1::ErrorReason_Name(v1::BAD_TOKEN)
                                         ? AuthenticationFailure::kBadToken
                                         : AuthenticationFailure::kBadCertificate;
  options_.metrics->authentication_failures[kind].Add();
  constexpr char kEvent[] = "authentication_failed";
  const std::optional<uint64_t> suppressed = limiter_.Admit(kEvent, peer);
  if (!suppressed.has_value()) return;
  Log(LogLevel::kWarning, kEvent,
      {{"peer", peer}, {"reason", reason}, {"message", status.message()}, {"suppressed", *suppressed}});
}

absl::StatusOr<Caller> Authenticator::CallerOfToken(const std::vector<absl::string_view>& authorization) const {
  if (authorization.empty()) {
    return Unauthenticated(
        v1::NO_TOKEN, "the server requires a token: give --token-file (API: metadata authorization, \"Bearer TOKEN\")");
  }
  if (authorization.size() > 1 || !absl::StartsWithIgnoreCase(authorization.front(), kScheme)) {
    return Unauthenticated(v1::BAD_TOKEN, "the metadata authorization must have exactly one value, \"Bearer TOKEN\"");
  }
  std::optional<Caller> caller = tokens_->Find(authorization.front().substr(kScheme.size()));
  if (!caller.has_value()) {
    return Unauthenticated(v1::BAD_TOKEN, "this token is not valid at this server: ask its operator for one");
  }
  return *std::move(caller);
}

}  // namespace evpose::server
