// SPDX-License-Identifier: Apache-2.0

// Who a gRPC call comes from. Every method of every service asks first; rpc_test calls each method that the API
// declares without a token, so one that forgets is found.
#pragma once

#include <grpcpp/server_context.h>

#include <utility>

#include "absl/status/statusor.h"
#include "server/auth/authenticator.h"
#include "server/rpc/status_mapping.h"
#include "server/runtime/worker_pool.h"

namespace evpose::server {

// Errors: those of Authenticator::Authenticate.
absl::StatusOr<Caller> Authenticate(Authenticator& authenticator, const grpc::ServerContextBase& context);

// Ends a call of one request and one response, at once: with what `answer(caller)` says, an absl::Status.
template <typename Answer>
grpc::ServerUnaryReactor* AnswerUnary(Authenticator& authenticator, grpc::CallbackServerContext* context,
                                      const Answer& answer) {
  const absl::StatusOr<Caller> caller = Authenticate(authenticator, *context);
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(ToGrpcStatus(caller.ok() ? answer(*caller) : caller.status()));
  return reactor;
}

// The same for an answer that may wait for the store: too long for gRPC's threads, and for those that track.
template <typename Answer>
grpc::ServerUnaryReactor* AnswerSlowly(Authenticator& authenticator, WorkerPool& pool,
                                       grpc::CallbackServerContext* context, Answer answer) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  absl::StatusOr<Caller> caller = Authenticate(authenticator, *context);
  if (!caller.ok()) {
    reactor->Finish(ToGrpcStatus(caller.status()));
    return reactor;
  }
  pool.PostSlow([reactor, answer = std::move(answer), asking = *std::move(caller)] {
    reactor->Finish(ToGrpcStatus(answer(asking)));
  });
  return reactor;
}

}  // namespace evpose::server
