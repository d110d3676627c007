// SPDX-License-Identifier: Apache-2.0

// The method ModelService.GetModelGeometry.
#pragma once

#include <grpcpp/support/server_callback.h>

#include "absl/status/statusor.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "server/auth/authenticator.h"
#include "server/models/model_registry.h"
#include "server/rpc/common/pending_response.h"
#include "server/runtime/slow_executor.h"
#include "server/sessions/memory/memory_budget.h"

namespace evpose::server {

// Starts the reactor of a call by `caller`, or the error for one that is not admitted. The geometry is made by
// `preparations`; the model is charged to `memory` meanwhile. `limits` bound the response until the client has taken
// it. The reactor deletes itself when the call has ended.
grpc::ServerUnaryReactor* StartGetModelGeometry(ModelRegistry& models, SlowExecutor& preparations, MemoryBudget& memory,
                                                const ResponseLimits& limits, const absl::StatusOr<Caller>& caller,
                                                grpc::CallbackServerContext& context,
                                                const v1::GetModelGeometryRequest& request,
                                                v1::ModelGeometry& response);

}  // namespace evpose::server
