// SPDX-License-Identifier: Apache-2.0

// The servers of a client and the calls that all its operations share. Internal: it includes generated headers.
#pragma once

#include <grpcpp/channel.h>
#include <grpcpp/client_context.h>

#include <atomic>
#include <map>
#include <memory>
#include <mutex>
#include <stop_token>
#include <string>
#include <type_traits>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "client/lib/conversion.h"
#include "client/lib/stream/event_feed.h"
#include "core/base/status_macros.h"
#include "evpose/client.h"
#include "evpose/clock.h"
#include "evpose/v1/admin_service.grpc.pb.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {

using Admin = v1::AdminService::StubInterface;
using Models = v1::ModelService::StubInterface;
using Sessions = v1::SessionService::StubInterface;

struct Client::Impl {
  struct Endpoint {
    std::shared_ptr<grpc::Channel> channel;
    std::string name;
    std::unique_ptr<Admin> admin;
    std::unique_ptr<Models> models;
    std::unique_ptr<Sessions> sessions;
  };

  std::vector<Endpoint> endpoints;
  std::atomic<size_t> current = 0;  // the server that calls go to
  bool sessions_outlive_server = false;
  std::mutex feeds_mutex;
  std::map<std::string, EventFeed*> feeds ABSL_GUARDED_BY(feeds_mutex);  // of the running Track() calls, by session
  ClientOptions options;
  Clock* clock = &SystemClock();

  const Endpoint& endpoint() const { return endpoints[current]; }
  bool IsCancelled() const { return options.is_cancelled && options.is_cancelled(); }
  void AddEndpoint(std::shared_ptr<grpc::Channel> channel, const std::string& name);
  // Returns false at the timeout; FAILED_PRECONDITION if TLS prevents the connection.
  absl::StatusOr<bool> WaitForServer();
  bool WaitForServerUntil(absl::Time deadline);
  // Uploads a model once. Error: ABORTED if another server has deleted it during the upload.
  absl::StatusOr<ModelInfo> TryUpload(absl::Span<const uint8_t> bytes, const UploadOptions& upload);

  // Makes one call with the deadline of the options: `method` of the member `stub` of the current endpoint. A request
  // of `stop` cancels it.
  template <typename Stub, typename Request, typename Response>
  absl::StatusOr<Response> Unary(std::unique_ptr<Stub> Endpoint::*stub,
                                 grpc::Status (Stub::*method)(grpc::ClientContext*, const Request&, Response*),
                                 const std::type_identity_t<Request>& request, const std::stop_token& stop = {}) {
    grpc::ClientContext context;
    context.set_deadline(absl::ToChronoTime(absl::Now() + options.call_timeout));
    const std::stop_callback cancel_on_stop(stop, [&context] { context.TryCancel(); });
    Response response;
    const grpc::Status status = ((*(endpoint().*stub)).*method)(&context, request, &response);
    if (!status.ok()) return FromGrpc(status, endpoint().name);
    return response;
  }

  // Requests all pages of a list, and calls `append(response)` for each page.
  template <typename Stub, typename Request, typename Response, typename Append>
  absl::Status AllPages(std::unique_ptr<Stub> Endpoint::*stub,
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
