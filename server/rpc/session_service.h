// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "evpose/v1/session_service.grpc.pb.h"
#include "server/rpc/common/service_context.h"

namespace evpose::server {

// Implements SessionService; errors are documented in proto/evpose/v1/session_service.proto.
class SessionServiceImpl : public v1::SessionService::CallbackService {
 public:
  explicit SessionServiceImpl(const ServiceContext& services) : services_(services) {}

  grpc::ServerUnaryReactor* CreateSession(grpc::CallbackServerContext* context, const v1::CreateSessionRequest* request,
                                          v1::CreateSessionResponse* response) override;
  grpc::ServerUnaryReactor* GetSession(grpc::CallbackServerContext* context, const v1::GetSessionRequest* request,
                                       v1::Session* response) override;
  grpc::ServerUnaryReactor* ListSessions(grpc::CallbackServerContext* context, const v1::ListSessionsRequest* request,
                                         v1::ListSessionsResponse* response) override;
  grpc::ServerUnaryReactor* DeleteSession(grpc::CallbackServerContext* context, const v1::DeleteSessionRequest* request,
                                          google::protobuf::Empty* response) override;
  grpc::ServerBidiReactor<v1::TrackRequest, v1::TrackResponse>* Track(grpc::CallbackServerContext* context) override;
  grpc::ServerWriteReactor<v1::WatchPosesResponse>* WatchPoses(grpc::CallbackServerContext* context,
                                                               const v1::WatchPosesRequest* request) override;
  grpc::ServerWriteReactor<v1::WatchHealthResponse>* WatchHealth(grpc::CallbackServerContext* context,
                                                                 const v1::WatchHealthRequest* request) override;
  grpc::ServerWriteReactor<v1::WatchEventsResponse>* WatchEvents(grpc::CallbackServerContext* context,
                                                                 const v1::WatchEventsRequest* request) override;

 private:
  const ServiceContext services_;
};

}  // namespace evpose::server
