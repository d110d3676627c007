#include "server/rpc/admin_service.h"

#include <string>

#include "server/rpc/conversion.h"

namespace evpose::server {

grpc::ServerUnaryReactor* AdminServiceImpl::GetServerInfo(grpc::CallbackServerContext* context,
                                                          const v1::GetServerInfoRequest*, v1::ServerInfo* response) {
  const SessionManager::Options& options = services_.sessions.options();
  response->set_version(EVPOSE_VERSION);
  response->set_active_sessions(services_.sessions.num_sessions());
  response->set_max_sessions(options.max_sessions);
  response->set_draining(!services_.sessions.CheckNotDraining().ok());
  response->set_max_chunk_bytes(options.limits.max_chunk_bytes);
  response->set_store(std::string(services_.store.kind()));
  response->set_max_model_bytes(services_.max_model_bytes);
  response->set_pose_log_capacity(static_cast<uint32_t>(services_.store.pose_log_capacity()));
  *response->mutable_session_expiry() = ToProto(options.limits.expiry);
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(grpc::Status::OK);
  return reactor;
}

}  // namespace evpose::server
