// SPDX-License-Identifier: Apache-2.0

// SessionService.Track: one stream between a client and a session.
#pragma once

#include <grpcpp/server_context.h>

#include "evpose/v1/session_service.grpc.pb.h"
#include "server/rpc/common/service_context.h"

namespace evpose::server {

// Starts a reactor that deletes itself when the call is over.
grpc::ServerBidiReactor<v1::TrackRequest, v1::TrackResponse>* StartTrack(const ServiceContext& services,
                                                                         grpc::CallbackServerContext* context);

}  // namespace evpose::server
