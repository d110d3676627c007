// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/common/authentication.h"

#include <grpc/grpc_security_constants.h>

#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/trace_context.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

absl::string_view View(const grpc::string_ref& text) { return {text.data(), text.size()}; }

}  // namespace

absl::StatusOr<Caller> Authenticate(Authenticator& authenticator, const grpc::ServerContextBase& context) {
  CallCredentials credentials;
  const auto [begin, end] = context.client_metadata().equal_range("authorization");
  for (auto it = begin; it != end; ++it) credentials.authorization.push_back(View(it->second));
  const std::shared_ptr<const grpc::AuthContext> connection = context.auth_context();
  std::vector<grpc::string_ref> certificates;
  if (connection != nullptr) certificates = connection->FindPropertyValues(GRPC_X509_PEM_CERT_PROPERTY_NAME);
  if (!certificates.empty()) credentials.certificate_pem = View(certificates.front());
  const std::string peer = context.peer();
  credentials.peer = peer;
  return authenticator.Authenticate(credentials);
}

absl::Status StillAdmitted(Authenticator& authenticator, const grpc::ServerContextBase& context,
                           const absl::StatusOr<Caller>& caller, const AccessCheck& check, uint64_t& version) {
  if (!caller.ok() || (check.version == version && check.now < caller->expires)) return absl::OkStatus();
  const absl::StatusOr<Caller> again = Authenticate(authenticator, context);
  if (again.ok() && again->tenant == caller->tenant) {
    version = check.version;
    return absl::OkStatus();
  }
  const absl::string_view cause = again.ok() ? "the token now belongs to another tenant" : again.status().message();
  return WithReason(absl::UnauthenticatedError(absl::StrCat("access was withdrawn while the stream was open: ", cause)),
                    v1::ACCESS_WITHDRAWN);
}

StreamOrigin OriginOf(const grpc::ServerContextBase& context, const std::string& peer, absl::string_view session) {
  StreamOrigin origin = {.peer = peer};
  const std::string trace_id = TraceIdOf(session);
  const auto [begin, end] = context.client_metadata().equal_range(kTraceparentKey);
  for (auto it = begin; it != end; ++it) {
    const std::optional<TraceContext> sent = ParseTraceparent(View(it->second));
    if (!sent.has_value()) continue;
    const bool is_own = sent->trace_id == trace_id;
    std::string& found = is_own ? origin.span_id : origin.client_trace_id;
    if (found.empty()) found = is_own ? sent->span_id : sent->trace_id;
  }
  if (origin.span_id.empty()) origin.span_id = NewSpanId();
  return origin;
}

}  // namespace evpose::server
