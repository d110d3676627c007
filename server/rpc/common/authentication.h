// SPDX-License-Identifier: Apache-2.0

// What the metadata of a gRPC call say: its caller and its trace context. Every method of every service authenticates
// first. rpc_test calls each method of the API without a token, so that a method without authentication fails the test.
#pragma once

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <memory>
#include <string>
#include <utility>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/auth/authenticator.h"
#include "server/rpc/common/status_mapping.h"
#include "server/runtime/out_of_memory.h"
#include "server/runtime/worker_pool.h"
#include "server/telemetry/session_log.h"

namespace evpose::server {

// Returns the caller, including the address of the client. Errors: those of Authenticator::Authenticate().
absl::StatusOr<Caller> Authenticate(Authenticator& authenticator, const grpc::ServerContextBase& context);

// Checks the caller of an open stream again if its certificate has expired, or if the tokens or revocations have
// changed since `version`, which it then updates: the Authenticator::version() from before the caller was admitted. To
// be called before the stream is finished. OK for a caller that was not admitted. Errors: UNAUTHENTICATED
// (ACCESS_WITHDRAWN) if the caller is no longer admitted, or belongs to another tenant.
absl::Status StillAdmitted(Authenticator& authenticator, const grpc::ServerContextBase& context,
                           const absl::StatusOr<Caller>& caller, const AccessCheck& check, uint64_t& version);

// Returns the origin of a stream of `session`, for the log. The span ID is that of the header `traceparent`
// (core/base/trace_context.h) with the session's trace ID; a new one is made if the client sent no such header. A
// client may also send a header with the trace ID of its own program. Malformed headers are ignored.
StreamOrigin OriginOf(const grpc::ServerContextBase& context, const std::string& peer, absl::string_view session);

// Authenticates a unary call and finishes it immediately with the absl::Status that `handler(caller)` returns.
template <typename Handler>
grpc::ServerUnaryReactor* FinishUnary(Authenticator& authenticator, grpc::CallbackServerContext* context,
                                      const Handler& handler) {
  const absl::StatusOr<Caller> caller = Authenticate(authenticator, *context);
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(
      ToGrpcStatus(caller.ok() ? OrOutOfMemory([&] { return absl::Status(handler(*caller)); }) : caller.status()));
  return reactor;
}

// The reactor of a unary call whose work is slow. The work ends early when the client cancels the call. Deletes itself
// when the call has ended.
class SlowCallReactor : public grpc::ServerUnaryReactor {
 public:
  void OnCancel() override { cancellation_->Cancel(); }
  void OnDone() override { delete this; }
  const std::shared_ptr<Cancellation>& cancellation() const { return cancellation_; }

 private:
  const std::shared_ptr<Cancellation> cancellation_ = std::make_shared<Cancellation>();
};

// Runs `handler()`, which finishes the call, on the pool's threads for slow work, because it may wait for the store and
// must block neither gRPC's threads nor the workers. A call that was cancelled before its turn, that the shutdown ends,
// or for which there is no memory, is finished without it.
template <typename Handler>
void PostCall(WorkerPool& pool, const std::string& tenant, SlowCallReactor* reactor, Handler handler) {
  const absl::Status posted = pool.slow().TryPost(
      tenant,
      [reactor, handler = std::move(handler)](const absl::Status& admitted) {
        if (!admitted.ok()) return reactor->Finish(ToGrpcStatus(admitted));
        handler();
      },
      reactor->cancellation());
  if (!posted.ok()) reactor->Finish(ToGrpcStatus(posted));
}

// Does the same as FinishUnary(), but runs `handler` with PostCall().
template <typename Handler>
grpc::ServerUnaryReactor* PostUnary(Authenticator& authenticator, WorkerPool& pool,
                                    grpc::CallbackServerContext* context, Handler handler) {
  absl::StatusOr<Caller> caller = Authenticate(authenticator, *context);
  auto* const reactor = new SlowCallReactor;
  if (!caller.ok()) {
    reactor->Finish(ToGrpcStatus(caller.status()));
    return reactor;
  }
  const std::string tenant = caller->tenant;
  PostCall(pool, tenant, reactor, [reactor, handler = std::move(handler), caller = *std::move(caller)] {
    reactor->Finish(ToGrpcStatus(OrOutOfMemory([&] { return absl::Status(handler(caller)); })));
  });
  return reactor;
}

}  // namespace evpose::server
