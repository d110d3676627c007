// SPDX-License-Identifier: Apache-2.0

// SessionService.WatchPoses and WatchHealth: readers of a session.
#pragma once

#include <grpcpp/server_context.h>

#include "evpose/v1/session_service.grpc.pb.h"
#include "server/rpc/service_context.h"

namespace evpose::server {

// Reactors that delete themselves when the call is over.
grpc::ServerWriteReactor<v1::WatchPosesResponse>* StartWatchPoses(const ServiceContext& services,
                                                                  grpc::CallbackServerContext* context,
                                                                  const v1::WatchPosesRequest& request);
grpc::ServerWriteReactor<v1::WatchHealthResponse>* StartWatchHealth(const ServiceContext& services,
                                                                    grpc::CallbackServerContext* context,
                                                                    const v1::WatchHealthRequest& request);

}  // namespace evpose::server
