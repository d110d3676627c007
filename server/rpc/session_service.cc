// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/session_service.h"

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/rpc/common/authentication.h"
#include "server/rpc/common/conversion.h"
#include "server/rpc/common/status_mapping.h"
#include "server/rpc/standard_methods.h"
#include "server/rpc/track_reactor.h"
#include "server/rpc/watch/watch_reactors.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {
namespace {

constexpr size_t kMaxRequestIdBytes = 128;  // as the API states; a UUID has 36

absl::StatusOr<std::shared_ptr<Session>> Create(SessionManager& sessions, const Caller& caller,
                                                const v1::CreateSessionRequest& request) {
  if (request.request_id().size() > kMaxRequestIdBytes) {
    return InvalidField("request_id", absl::StrCat("has ", request.request_id().size(), " bytes; at most ",
                                                   kMaxRequestIdBytes, " are kept"));
  }
  EVPOSE_ASSIGN_OR_RETURN(const SessionConfig config, FromProto(request.config()));
  return sessions.Create(caller.tenant, config, request.request_id(), caller.peer);
}

// Finishes the call with the session and its resume token. For a session that was loaded from the store, the server has
// only the digest of the token, and the client did not receive the token; so a new token is issued and sent when it is
// durable. If the store does not respond, the call fails instead of waiting without limit.
void FinishCreate(const absl::StatusOr<std::shared_ptr<Session>>& session, Store& store, const std::string& tenant,
                  v1::CreateSessionResponse& response, UnaryReactor& reactor) {
  const absl::Status status = OrOutOfMemory([&]() -> absl::Status {
    EVPOSE_RETURN_IF_ERROR(session.status());
    *response.mutable_session() = ToProto((*session)->Describe());
    response.set_resume_token((*session)->resume_token());
    return response.resume_token().empty() ? FromStore(store.CheckHealth()) : absl::OkStatus();
  });
  if (!status.ok() || !response.resume_token().empty()) return reactor.Answer(tenant, status);
  (*session)->RenewToken([tenant, &response, &reactor](const absl::StatusOr<std::string>& token) {
    if (token.ok()) response.set_resume_token(*token);
    reactor.Answer(tenant, token.status());
  });
}

absl::Status List(SessionManager& sessions, const std::string& tenant, const v1::ListSessionsRequest& request,
                  v1::ListSessionsResponse& response) {
  EVPOSE_ASSIGN_OR_RETURN(const size_t page_size, PageSize(request.page_size()));
  EVPOSE_ASSIGN_OR_RETURN(const std::string after_name, PageStart(request.page_token(), "sessions/"));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<SessionInfo> page, sessions.List(tenant, after_name, page_size + 1));
  for (const SessionInfo& session : page) {
    if (response.sessions_size() == static_cast<int>(page_size)) {
      response.set_next_page_token(response.sessions().rbegin()->name());
      break;
    }
    *response.add_sessions() = ToProto(session);
  }
  return absl::OkStatus();
}

}  // namespace

grpc::ServerUnaryReactor* SessionServiceImpl::CreateSession(grpc::CallbackServerContext* context,
                                                            const v1::CreateSessionRequest* request,
                                                            v1::CreateSessionResponse* response) {
  const absl::StatusOr<Caller> caller = Authenticate(services_.authenticator, *context);
  auto* const reactor = new UnaryReactor(LimitsOf(services_), *context, *response);
  if (!caller.ok()) {
    reactor->Refuse(caller.status());
    return reactor;
  }
  // Creating trackers takes too long for gRPC's threads and for the workers.
  PostCall(services_.pool, caller->tenant, reactor, [this, request, response, reactor, caller = *caller] {
    FinishCreate(OrOutOfMemory([&] { return Create(services_.sessions, caller, *request); }), services_.store,
                 caller.tenant, *response, *reactor);
  });
  return reactor;
}

grpc::ServerUnaryReactor* SessionServiceImpl::GetSession(grpc::CallbackServerContext* context,
                                                         const v1::GetSessionRequest* request, v1::Session* response) {
  const auto describe = [this, request, response](const Caller& caller) -> absl::Status {
    EVPOSE_ASSIGN_OR_RETURN(const SessionInfo session, services_.sessions.Describe(caller.tenant, request->name()));
    *response = ToProto(session);
    return absl::OkStatus();
  };
  const absl::StatusOr<Caller> caller = Authenticate(services_.authenticator, *context);
  if (!caller.ok() || !services_.sessions.Get(caller->tenant, request->name()).ok()) {
    return PostUnary(services_, context, response, describe);
  }
  return FinishUnary(services_, context, response, describe);
}

grpc::ServerUnaryReactor* SessionServiceImpl::ListSessions(grpc::CallbackServerContext* context,
                                                           const v1::ListSessionsRequest* request,
                                                           v1::ListSessionsResponse* response) {
  return PostUnary(services_, context, response, [this, request, response](const Caller& caller) {
    return List(services_.sessions, caller.tenant, *request, *response);
  });
}

grpc::ServerUnaryReactor* SessionServiceImpl::DeleteSession(grpc::CallbackServerContext* context,
                                                            const v1::DeleteSessionRequest* request,
                                                            google::protobuf::Empty* response) {
  return PostUnary(services_, context, response, [this, request](const Caller& caller) {
    return DeletionStatus(services_.sessions.Delete(caller.tenant, request->name(), caller.peer),
                          request->allow_missing());
  });
}

grpc::ServerBidiReactor<v1::TrackRequest, v1::TrackResponse>* SessionServiceImpl::Track(
    grpc::CallbackServerContext* context) {
  return StartTrack(services_, context);
}

grpc::ServerWriteReactor<v1::WatchPosesResponse>* SessionServiceImpl::WatchPoses(grpc::CallbackServerContext* context,
                                                                                 const v1::WatchPosesRequest* request) {
  return StartWatchPoses(services_, context, *request);
}

grpc::ServerWriteReactor<v1::WatchHealthResponse>* SessionServiceImpl::WatchHealth(
    grpc::CallbackServerContext* context, const v1::WatchHealthRequest* request) {
  return StartWatchHealth(services_, context, *request);
}

grpc::ServerWriteReactor<v1::WatchEventsResponse>* SessionServiceImpl::WatchEvents(
    grpc::CallbackServerContext* context, const v1::WatchEventsRequest* request) {
  return StartWatchEvents(services_, context, *request);
}

}  // namespace evpose::server
