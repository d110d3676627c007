#include "server/rpc/session_service.h"

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/rpc/conversion.h"
#include "server/rpc/status_mapping.h"
#include "server/rpc/track_reactor.h"
#include "server/rpc/watch_reactors.h"
#include "server/sessions/errors.h"

namespace evpose::server {
namespace {

constexpr size_t kMaxRequestIdBytes = 128;

absl::Status Create(SessionManager& sessions, const v1::CreateSessionRequest& request, v1::Session& response) {
  if (request.request_id().size() > kMaxRequestIdBytes) {
    return InvalidField("request_id", absl::StrCat("has ", request.request_id().size(), " bytes; at most ",
                                                   kMaxRequestIdBytes, " are kept"));
  }
  EVPOSE_ASSIGN_OR_RETURN(const SessionConfig config, FromProto(request.config()));
  EVPOSE_ASSIGN_OR_RETURN(const std::shared_ptr<Session> session, sessions.Create(config, request.request_id()));
  response = ToProto(*session);
  response.set_resume_token(session->resume_token());
  return absl::OkStatus();
}

absl::Status List(SessionManager& sessions, const v1::ListSessionsRequest& request,
                  v1::ListSessionsResponse& response) {
  EVPOSE_ASSIGN_OR_RETURN(const size_t page_size, PageSize(request.page_size()));
  EVPOSE_ASSIGN_OR_RETURN(const std::string after_name, PageStart(request.page_token(), "sessions/"));
  const auto page = sessions.List(after_name, page_size + 1);
  for (const auto& session : page) {
    if (response.sessions_size() == static_cast<int>(page_size)) {
      response.set_next_page_token(response.sessions().rbegin()->name());
      break;
    }
    *response.add_sessions() = ToProto(*session);
  }
  return absl::OkStatus();
}

}  // namespace

grpc::ServerUnaryReactor* SessionServiceImpl::CreateSession(grpc::CallbackServerContext* context,
                                                            const v1::CreateSessionRequest* request,
                                                            v1::Session* response) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  // Making trackers takes too long for gRPC's threads.
  services_.pool.Post([this, request, response, reactor] {
    reactor->Finish(ToGrpcStatus(Create(services_.sessions, *request, *response)));
  });
  return reactor;
}

grpc::ServerUnaryReactor* SessionServiceImpl::GetSession(grpc::CallbackServerContext* context,
                                                         const v1::GetSessionRequest* request, v1::Session* response) {
  const auto session = services_.sessions.Get(request->name());
  if (session.ok()) *response = ToProto(**session);
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(ToGrpcStatus(session.status()));
  return reactor;
}

grpc::ServerUnaryReactor* SessionServiceImpl::ListSessions(grpc::CallbackServerContext* context,
                                                           const v1::ListSessionsRequest* request,
                                                           v1::ListSessionsResponse* response) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(ToGrpcStatus(List(services_.sessions, *request, *response)));
  return reactor;
}

grpc::ServerUnaryReactor* SessionServiceImpl::DeleteSession(grpc::CallbackServerContext* context,
                                                            const v1::DeleteSessionRequest* request,
                                                            v1::DeleteSessionResponse*) {
  services_.sessions.Delete(request->name());
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(grpc::Status::OK);
  return reactor;
}

grpc::ServerBidiReactor<v1::TrackRequest, v1::TrackResponse>* SessionServiceImpl::Track(
    grpc::CallbackServerContext* context) {
  return StartTrack(services_, context);
}

grpc::ServerWriteReactor<v1::WatchPosesResponse>* SessionServiceImpl::WatchPoses(grpc::CallbackServerContext* context,
                                                                                 const v1::WatchPosesRequest* request) {
  return StartWatchPoses(services_, context, *request);
}

grpc::ServerWriteReactor<v1::SessionHealth>* SessionServiceImpl::WatchHealth(grpc::CallbackServerContext* context,
                                                                             const v1::WatchHealthRequest* request) {
  return StartWatchHealth(services_, context, *request);
}

}  // namespace evpose::server
