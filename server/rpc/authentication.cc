// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/authentication.h"

#include <grpc/grpc_security_constants.h>

#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

absl::string_view View(const grpc::string_ref& text) { return {text.data(), text.size()}; }

}  // namespace

absl::StatusOr<Caller> Authenticate(Authenticator& authenticator, const grpc::ServerContextBase& context) {
  CallCredentials credentials;
  const auto [begin, end] = context.client_metadata().equal_range("authorization");
  for (auto it = begin; it != end; ++it) credentials.authorization.push_back(View(it->second));
  const std::shared_ptr<const grpc::AuthContext> connection = context.auth_context();
  std::vector<grpc::string_ref> names;
  if (connection != nullptr) names = connection->FindPropertyValues(GRPC_X509_CN_PROPERTY_NAME);
  if (names.size() == 1) credentials.certificate_name = View(names.front());
  EVPOSE_ASSIGN_OR_RETURN(Caller caller, authenticator.Authenticate(credentials));
  caller.peer = context.peer();
  return caller;
}

}  // namespace evpose::server
