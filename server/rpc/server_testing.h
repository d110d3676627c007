// SPDX-License-Identifier: Apache-2.0

// A fixture with a running server, fake trackers and raw stubs, which can send requests that the client library never
// sends.
#pragma once

#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "evpose/v1/admin_service.grpc.pb.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "google/rpc/error_details.pb.h"
#include "google/rpc/status.pb.h"
#include "server/rpc/raw_requests_testing.h"
#include "server/rpc/server_impl.h"
#include "server/sessions/session_testing.h"

namespace evpose::server {

// Returns the first error detail of this type; empty if there is none.
template <typename Detail>
Detail DetailOf(const grpc::Status& status) {
  google::rpc::Status details;
  Detail detail;
  if (!details.ParseFromString(status.error_details())) return detail;
  for (const auto& any : details.details()) {
    if (any.UnpackTo(&detail)) break;
  }
  return detail;
}

inline std::string FieldOf(const grpc::Status& status) {
  const auto bad_request = DetailOf<google::rpc::BadRequest>(status);
  return bad_request.field_violations().empty() ? "" : bad_request.field_violations(0).field();
}
inline std::string ReasonOf(const grpc::Status& status) {
  const auto info = DetailOf<google::rpc::ErrorInfo>(status);
  return info.domain() == "evpose.v1" ? info.reason() : "";
}

// Returns the status code followed by a space and the field or the reason, for example "NOT_FOUND SESSION_NOT_FOUND".
inline std::string Describe(const grpc::Status& status) {
  static constexpr const char* kNames[] = {
      "OK",        "CANCELLED",      "UNKNOWN",           "INVALID_ARGUMENT",   "DEADLINE_EXCEEDED",
      "NOT_FOUND", "ALREADY_EXISTS", "PERMISSION_DENIED", "RESOURCE_EXHAUSTED", "FAILED_PRECONDITION",
      "ABORTED",   "OUT_OF_RANGE",   "UNIMPLEMENTED",     "INTERNAL",           "UNAVAILABLE",
      "DATA_LOSS", "UNAUTHENTICATED"};
  const std::string detail = FieldOf(status) + ReasonOf(status);
  return absl::StrCat(kNames[status.error_code()], detail.empty() ? "" : " ", detail);
}

class RpcTest : public ::testing::Test {
 protected:
  static ServerOptions Options() {
    ServerOptions options;
    options.listen_address = "";
    options.worker_threads = 2;
    options.max_sessions = 4;
    options.max_model_bytes = 4096;
    options.max_model_store_bytes = 16384;
    options.max_chunk_bytes = 64 * 1024;
    options.credit_bytes = uint64_t{256} * 1024;
    return options;
  }

  explicit RpcTest(const ServerOptions& options = Options()) { Connect(options); }
  ~RpcTest() override { gate_->Open(); }

  void Connect(const ServerOptions& options) {
    server_ = StartServer(options, FakeTrackers(gate_)).value();
    Use(server_->InProcessChannel());
  }
  // For tests of a status that the shutdown sends: gRPC's in-process channel may drop a final status that was not read
  // before the server closed.
  void ConnectThroughSocket(ServerOptions options) {
    options.listen_address = "127.0.0.1:0";
    server_ = StartServer(options, FakeTrackers(gate_)).value();
    Use(grpc::CreateChannel(absl::StrCat("127.0.0.1:", server_->port()), grpc::InsecureChannelCredentials()));
  }
  void Use(const std::shared_ptr<grpc::Channel>& channel) {
    channel_ = channel;
    sessions_ = v1::SessionService::NewStub(channel);
    models_ = v1::ModelService::NewStub(channel);
    admin_ = v1::AdminService::NewStub(channel);
  }

  grpc::Status Upload(const std::vector<v1::UploadModelRequest>& requests, v1::Model* model) {
    return UploadModel(*models_, requests, model);
  }
  std::string UploadCube() {
    v1::Model model;
    EXPECT_EQ(Describe(Upload(UploadRequests(kCubeObj), &model)), "OK");
    return model.name();
  }

  v1::CreateSessionRequest CreateRequest() { return CubeSessionRequest(UploadCube()); }
  grpc::Status Create(const v1::CreateSessionRequest& request, CreatedSession* session) {
    grpc::ClientContext context;
    return sessions_->CreateSession(&context, request, session->response());
  }
  CreatedSession CreateSession() {
    CreatedSession session;
    EXPECT_EQ(Describe(Create(CreateRequest(), &session)), "OK");
    return session;
  }
  grpc::Status Get(const std::string& name, CreatedSession* session) {
    grpc::ClientContext context;
    v1::GetSessionRequest request;
    request.set_name(name);
    return sessions_->GetSession(&context, request, session->mutable_session());
  }
  grpc::Status Delete(const std::string& name, bool allow_missing = false) {
    grpc::ClientContext context;
    v1::DeleteSessionRequest request;
    request.set_name(name);
    request.set_allow_missing(allow_missing);
    google::protobuf::Empty response;
    return sessions_->DeleteSession(&context, request, &response);
  }
  // Opens a stream and attaches it to `session`.
  std::unique_ptr<RawTrack> Attached(const CreatedSession& session, v1::TrackResponse::Attached* attached = nullptr) {
    auto track = std::make_unique<RawTrack>(*sessions_);
    EXPECT_TRUE(track->Attach(session.name(), session.resume_token()));
    v1::TrackResponse response;
    EXPECT_TRUE(track->Read(response));
    EXPECT_TRUE(response.has_attached());
    if (attached != nullptr) *attached = response.attached();
    return track;
  }

  // Creates a session with LATEST and sends more than the credit on a new stream. The tracker blocks at the first chunk
  // until the gate is opened.
  std::unique_ptr<RawTrack> OverloadedLatest(CreatedSession* session, uint64_t* sent_bytes) {
    v1::CreateSessionRequest request = CreateRequest();
    request.mutable_config()->set_overload_policy(v1::OVERLOAD_POLICY_LATEST);
    request.mutable_config()->mutable_max_lag()->set_seconds(10);
    EXPECT_EQ(Describe(Create(request, session)), "OK");
    auto track = Attached(*session);
    gate_->Close();
    for (uint64_t seq = 1; *sent_bytes < uint64_t{400} * 1024; ++seq) {
      const auto begin_ms = static_cast<int64_t>(1000 * seq);
      const std::string payload = Flat64(SomeEvents(begin_ms, begin_ms + 10, 300));
      EXPECT_TRUE(track->Events(seq, payload));
      *sent_bytes += payload.size();
      // Waits until the tracker has the first chunk, while the queue is short; otherwise it would start by dropping
      // events.
      if (seq == 1) gate_->AwaitTracker();
    }
    return track;
  }

  const std::shared_ptr<FakeTrackerGate> gate_ = std::make_shared<FakeTrackerGate>();
  std::unique_ptr<Server> server_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<v1::SessionService::Stub> sessions_;
  std::unique_ptr<v1::ModelService::Stub> models_;
  std::unique_ptr<v1::AdminService::Stub> admin_;
};

}  // namespace evpose::server
