// SPDX-License-Identifier: Apache-2.0

// The servers of a client and the calls that all its operations share. Internal: it includes generated headers.
#pragma once

#include <grpcpp/client_context.h>

#include <atomic>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <stop_token>
#include <string>
#include <type_traits>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "client/lib/messages/conversion.h"
#include "client/lib/server_choice.h"
#include "client/lib/stream/event_feed.h"
#include "core/base/status_macros.h"
#include "evpose/client.h"
#include "evpose/clock.h"

namespace evpose::client {

using Admin = v1::AdminService::StubInterface;
using Models = v1::ModelService::StubInterface;
using Sessions = v1::SessionService::StubInterface;

struct Client::Impl {
  std::deque<Endpoint> endpoints;
  std::atomic<size_t> current = 0;  // the server that calls go to
  bool sessions_outlive_server = false;
  uint64_t max_model_bytes = 0;  // limit of the server that Connect() found; 0: not known
  std::mutex feeds_mutex;
  std::map<std::string, EventFeed*> feeds ABSL_GUARDED_BY(feeds_mutex);  // of the running Track() calls, by session
  ClientOptions options;
  Clock* clock = &SystemClock();

  const Endpoint& endpoint() const { return endpoints[current]; }
  bool IsCancelled() const { return options.is_cancelled && options.is_cancelled(); }
  // Returns false at the timeout; FAILED_PRECONDITION if TLS prevents the connection.
  absl::StatusOr<bool> WaitForServer();
  bool WaitForServerUntil(absl::Time deadline);
  // Uploads a model once to each server until one responds. Error: ABORTED if another server has deleted it during the
  // upload.
  absl::StatusOr<ModelInfo> TryUpload(absl::Span<const uint8_t> bytes, const UploadOptions& upload);

  // Creates a session at a server with room for it, which is waited for as Client::CreateSession() describes.
  absl::StatusOr<v1::CreateSessionResponse> CreateWhereRoomIs(const v1::CreateSessionRequest& request,
                                                              absl::Duration max_wait, const std::stop_token& stop);

  // Returns the StatusOr of `call(endpoint, deadline)` at the current server, and at the next ones while a server is
  // unreachable or, with `skips_full_servers`, IsServerFull(). A call that has reached a server may be made again, so
  // that it must have the same effect as one call.
  template <typename Call>
  std::invoke_result_t<Call, const Endpoint&, absl::Time> AtAnyServer(const Call& call,
                                                                      const std::stop_token& stop = {},
                                                                      bool skips_full_servers = false) {
    ServerChoice choice(endpoints, current, *clock, stop, skips_full_servers);
    const absl::Time deadline = absl::Now() + options.call_timeout;  // of all attempts together
    while (true) {
      auto result = call(choice.endpoint(), deadline);
      if (choice.Next(result.status())) continue;
      if (result.ok()) return result;
      return choice.Final(result.status());
    }
  }

  // Makes one call of `method` of the member `stub` of a server. A request of `stop` cancels it.
  template <typename Stub, typename Request, typename Response>
  static absl::StatusOr<Response> UnaryAt(const Endpoint& endpoint, absl::Time deadline,
                                          std::unique_ptr<Stub> Connection::*stub,
                                          grpc::Status (Stub::*method)(grpc::ClientContext*, const Request&, Response*),
                                          const std::type_identity_t<Request>& request,
                                          const std::stop_token& stop = {}) {
    grpc::ClientContext context;
    context.set_deadline(absl::ToChronoTime(deadline));
    const std::stop_callback cancel_on_stop(stop, [&context] { context.TryCancel(); });
    Response response;
    const std::shared_ptr<const Connection> connection = endpoint.connection();
    const grpc::Status status = ((*((*connection).*stub)).*method)(&context, request, &response);
    if (!status.ok()) return FromGrpc(status, endpoint.name);
    return response;
  }

  // Calls UnaryAt() with the deadline of the options, at any server. Used only for calls that AtAnyServer() may repeat.
  template <typename Stub, typename Request, typename Response>
  absl::StatusOr<Response> Unary(std::unique_ptr<Stub> Connection::*stub,
                                 grpc::Status (Stub::*method)(grpc::ClientContext*, const Request&, Response*),
                                 const std::type_identity_t<Request>& request, const std::stop_token& stop = {}) {
    return AtAnyServer([&](const Endpoint& endpoint,
                           absl::Time deadline) { return UnaryAt(endpoint, deadline, stub, method, request, stop); },
                       stop);
  }

  // Calls UnaryAt() at the current server, for calls about the server itself.
  template <typename Stub, typename Request, typename Response>
  absl::StatusOr<Response> UnaryOnce(std::unique_ptr<Stub> Connection::*stub,
                                     grpc::Status (Stub::*method)(grpc::ClientContext*, const Request&, Response*),
                                     const std::type_identity_t<Request>& request) {
    endpoint().ConnectAgain(/*num_servers=*/1, {});
    return UnaryAt(endpoint(), absl::Now() + options.call_timeout, stub, method, request);
  }

  // Requests all pages of a list, and calls `append(response)` for each page.
  template <typename Stub, typename Request, typename Response, typename Append>
  absl::Status AllPages(std::unique_ptr<Stub> Connection::*stub,
                        grpc::Status (Stub::*method)(grpc::ClientContext*, const Request&, Response*),
                        const Append& append, const std::stop_token& stop = {}) {
    Request request;
    request.set_page_size(500);  // some hundred kilobytes, below gRPC's limit of 4 MiB for a message
    do {
      EVPOSE_ASSIGN_OR_RETURN(const Response response, Unary(stub, method, request, stop));
      EVPOSE_RETURN_IF_ERROR(append(response));
      request.set_page_token(response.next_page_token());
    } while (!request.page_token().empty());
    return absl::OkStatus();
  }
};

}  // namespace evpose::client
