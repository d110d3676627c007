// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "evpose/v1/admin_service.grpc.pb.h"
#include "server/rpc/common/service_context.h"

namespace evpose::server {

// Implements AdminService; errors are documented in proto/evpose/v1/admin_service.proto.
class AdminServiceImpl : public v1::AdminService::CallbackService {
 public:
  explicit AdminServiceImpl(const ServiceContext& services) : services_(services) {}

  grpc::ServerUnaryReactor* GetServerInfo(grpc::CallbackServerContext* context, const v1::GetServerInfoRequest* request,
                                          v1::ServerInfo* response) override;
  grpc::ServerUnaryReactor* Drain(grpc::CallbackServerContext* context, const v1::DrainRequest* request,
                                  v1::DrainResponse* response) override;
  grpc::ServerUnaryReactor* SetLogLevel(grpc::CallbackServerContext* context, const v1::SetLogLevelRequest* request,
                                        v1::SetLogLevelResponse* response) override;

 private:
  const ServiceContext services_;
};

}  // namespace evpose::server
