// SPDX-License-Identifier: Apache-2.0
#include "server/auth/authenticator.h"

#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

constexpr absl::string_view kScheme = "Bearer ";

absl::Status Unauthenticated(v1::ErrorReason reason, absl::string_view message) {
  return WithReason(absl::UnauthenticatedError(message), reason);
}

absl::StatusOr<Caller> CallerOfCertificate(const std::optional<absl::string_view>& name) {
  if (!name.has_value())
    return Unauthenticated(v1::BAD_CERTIFICATE, "the client's certificate has no common name (CN)");
  if (const absl::Status status = ValidateTenant(*name); !status.ok()) {
    return Unauthenticated(v1::BAD_CERTIFICATE, absl::StrCat("the certificate's CN: ", status.message()));
  }
  return Caller{std::string(*name), false};
}

}  // namespace

absl::StatusOr<std::unique_ptr<Authenticator>> Authenticator::Create(const Options& options) {
  std::unique_ptr<Authenticator> authenticator(new Authenticator);
  if (!options.token_file.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(authenticator->tokens_, TokenFile::Open(options.token_file));
  }
  authenticator->has_client_certificates_ = options.has_client_certificates;
  return authenticator;
}

absl::StatusOr<Caller> Authenticator::Authenticate(const CallCredentials& credentials) {
  if (tokens_ != nullptr) return CallerOfToken(credentials.authorization);
  if (has_client_certificates_) return CallerOfCertificate(credentials.certificate_name);
  return Caller{"", true};
}

absl::StatusOr<Caller> Authenticator::CallerOfToken(const std::vector<absl::string_view>& authorization) {
  if (authorization.empty()) {
    return Unauthenticated(
        v1::NO_TOKEN,
        "the server requires a token: send the metadata authorization, \"Bearer TOKEN\"; evpose reads it from "
        "--token-file");
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
