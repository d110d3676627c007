// SPDX-License-Identifier: Apache-2.0

// The method ModelService.GetModelGeometry.
#pragma once

#include <grpcpp/server_context.h>

#include "evpose/v1/model_service.grpc.pb.h"
#include "server/rpc/service_context.h"

namespace evpose::server {

// Starts the reactor of a call. It deletes itself when the call has ended.
grpc::ServerUnaryReactor* StartGetModelGeometry(const ServiceContext& services, grpc::CallbackServerContext* context,
                                                const v1::GetModelGeometryRequest& request,
                                                v1::ModelGeometry& response);

}  // namespace evpose::server
