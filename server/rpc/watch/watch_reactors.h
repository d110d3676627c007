// SPDX-License-Identifier: Apache-2.0

// The methods SessionService.WatchPoses, WatchHealth and WatchEvents.
#pragma once

#include <grpcpp/server_context.h>

#include "evpose/v1/session_service.grpc.pb.h"
#include "server/rpc/common/service_context.h"

namespace evpose::server {

// Start the reactor of a call. It deletes itself when the call has ended.
grpc::ServerWriteReactor<v1::WatchPosesResponse>* StartWatchPoses(const ServiceContext& services,
                                                                  grpc::CallbackServerContext* context,
                                                                  const v1::WatchPosesRequest& request);
grpc::ServerWriteReactor<v1::WatchHealthResponse>* StartWatchHealth(const ServiceContext& services,
                                                                    grpc::CallbackServerContext* context,
                                                                    const v1::WatchHealthRequest& request);
grpc::ServerWriteReactor<v1::WatchEventsResponse>* StartWatchEvents(const ServiceContext& services,
                                                                    grpc::CallbackServerContext* context,
                                                                    const v1::WatchEventsRequest& request);

}  // namespace evpose::server
