#include "server/rpc/admin_service.h"

#include <string>

#include "server/rpc/authentication.h"
#include "server/rpc/conversion.h"
#include "server/sessions/errors.h"

namespace evpose::server {

grpc::ServerUnaryReactor* AdminServiceImpl::GetServerInfo(grpc::CallbackServerContext* context,
                                                          const v1::GetServerInfoRequest*, v1::ServerInfo* response) {
  return AnswerUnary(services_.authenticator, context, [this, response](const Caller& caller) {
    const SessionManager::Options& options = services_.sessions.options();
    response->set_version(EVPOSE_VERSION);
    response->set_active_sessions(caller.is_operator ? services_.sessions.num_sessions()
                                                     : services_.sessions.num_sessions_of(caller.tenant));
    response->set_max_sessions(options.max_sessions);
    response->set_draining(!services_.sessions.CheckNotDraining().ok());
    response->set_max_chunk_bytes(options.limits.max_chunk_bytes);
    response->set_store(std::string(services_.store.kind()));
    response->set_max_model_bytes(services_.max_model_bytes);
    response->set_pose_log_capacity(options.limits.pose_log_capacity);
    *response->mutable_session_expiry() = ToProto(options.limits.expiry);
    if (caller.is_operator) response->set_skipped_events(services_.sessions.skipped_events());
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* AdminServiceImpl::Drain(grpc::CallbackServerContext* context, const v1::DrainRequest* request,
                                                  v1::DrainResponse* response) {
  return AnswerUnary(services_.authenticator, context, [this, request, response](const Caller& caller) -> absl::Status {
    if (!caller.is_operator) {
      return WithReason(absl::PermissionDeniedError("only an operator's token may drain the server"), "NOT_OPERATOR");
    }
    const absl::Duration deadline = request->has_timeout() ? FromProto(request->timeout()) : services_.drain_timeout;
    if (deadline < absl::ZeroDuration()) {
      return InvalidField("timeout", "is below 0; give the time that streams may take to finish");
    }
    services_.drainer.Drain(deadline);
    response->set_remaining_sessions(services_.sessions.num_attached());
    return absl::OkStatus();
  });
}

}  // namespace evpose::server
