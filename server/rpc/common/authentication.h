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
#include "server/rpc/common/pending_response.h"
#include "server/rpc/common/service_context.h"
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

// The reactor of a unary call. The work ends early when the client cancels the call. Deletes itself when the call has
// ended.
class UnaryReactor : public grpc::ServerUnaryReactor {
 public:
  UnaryReactor(const ResponseLimits& limits, grpc::CallbackServerContext& context, google::protobuf::Message& response)
      : response_(response), pending_(std::make_shared<PendingResponse>(limits, context)) {}

  void OnCancel() override { cancellation_->Cancel(); }
  void OnDone() override {
    pending_->End();
    delete this;
  }
  const std::shared_ptr<Cancellation>& cancellation() const { return cancellation_; }

  // Finishes the call without a response.
  void Refuse(const absl::Status& status) { Finish(ToGrpcStatus(status)); }
  // Finishes the call of a tenant. If `status` is OK, the response is complete; it counts for the tenant until the
  // client has taken it.
  void Answer(const std::string& tenant, absl::Status status) {
    if (status.ok()) status = OrOutOfMemory([&] { return pending_->Begin(tenant, response_); });
    Finish(ToGrpcStatus(status));
  }

 private:
  google::protobuf::Message& response_;
  const std::shared_ptr<PendingResponse> pending_;
  const std::shared_ptr<Cancellation> cancellation_ = std::make_shared<Cancellation>();
};

// Authenticates a unary call and finishes it immediately with `response` and the absl::Status that `handler(caller)`
// returns.
template <typename Handler>
grpc::ServerUnaryReactor* FinishUnary(const ServiceContext& services, grpc::CallbackServerContext* context,
                                      google::protobuf::Message* response, const Handler& handler) {
  auto* const reactor = new UnaryReactor(LimitsOf(services), *context, *response);
  const absl::StatusOr<Caller> caller = Authenticate(services.authenticator, *context);
  if (!caller.ok()) {
    reactor->Refuse(caller.status());
  } else {
    reactor->Answer(caller->tenant, OrOutOfMemory([&] { return absl::Status(handler(*caller)); }));
  }
  return reactor;
}

// Runs `handler()`, which finishes the call, on the pool's threads for slow work, because it may wait for the store and
// must block neither gRPC's threads nor the workers. A call that was cancelled before its turn, that the shutdown ends,
// or for which there is no memory, is finished without it.
template <typename Handler>
void PostCall(WorkerPool& pool, const std::string& tenant, UnaryReactor* reactor, Handler handler) {
  const absl::Status posted = pool.slow().TryPost(
      tenant,
      [reactor, handler = std::move(handler)](const absl::Status& admitted) {
        if (!admitted.ok()) return reactor->Refuse(admitted);
        handler();
      },
      reactor->cancellation());
  if (!posted.ok()) reactor->Refuse(posted);
}

// Does the same as FinishUnary(), but runs `handler` with PostCall().
template <typename Handler>
grpc::ServerUnaryReactor* PostUnary(const ServiceContext& services, grpc::CallbackServerContext* context,
                                    google::protobuf::Message* response, Handler handler) {
  absl::StatusOr<Caller> caller = Authenticate(services.authenticator, *context);
  auto* const reactor = new UnaryReactor(LimitsOf(services), *context, *response);
  if (!caller.ok()) {
    reactor->Refuse(caller.status());
    return reactor;
  }
  const std::string tenant = caller->tenant;
  PostCall(services.pool, tenant, reactor, [reactor, handler = std::move(handler), caller = *std::move(caller)] {
    reactor->Answer(caller.tenant, OrOutOfMemory([&] { return absl::Status(handler(caller)); }));
  });
  return reactor;
}

}  // namespace evpose::server
