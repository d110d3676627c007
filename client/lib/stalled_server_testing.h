// SPDX-License-Identifier: Apache-2.0

// A server that does not answer.
#pragma once

#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/client_access.h"
#include "evpose/client.h"
#include "evpose/v1/admin_service.grpc.pb.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {

// Has a client, and an address. Its calls end only when they are cancelled or the server stops, except for the first
// GetServerInfo, with which a client connects.
class StalledServer final : private v1::AdminService::CallbackService,
                            private v1::ModelService::CallbackService,
                            private v1::SessionService::CallbackService {
 public:
  // `on_call` gets the name of each method that is called, on a thread of gRPC.
  explicit StalledServer(std::function<void(const std::string& method)> on_call) : on_call_(std::move(on_call)) {
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
    builder.RegisterService(static_cast<v1::AdminService::CallbackService*>(this));
    builder.RegisterService(static_cast<v1::ModelService::CallbackService*>(this));
    builder.RegisterService(static_cast<v1::SessionService::CallbackService*>(this));
    server_ = builder.BuildAndStart();
    client_ = ClientAccess::OverChannel(server_->InProcessChannel({}), "test server");
  }
  Client& client() { return *client_; }
  std::string address() const { return absl::StrCat("127.0.0.1:", port_); }
  // Cancels all calls.
  void Stop() { server_->Shutdown(std::chrono::system_clock::now()); }

 private:
  class Reactor final : public grpc::ServerUnaryReactor {
   public:
    void OnCancel() override { Finish(grpc::Status::CANCELLED); }
    void OnDone() override { delete this; }
  };
  class HealthReactor final : public grpc::ServerWriteReactor<v1::WatchHealthResponse> {
   public:
    void OnCancel() override { Finish(grpc::Status::CANCELLED); }
    void OnDone() override { delete this; }
  };
  grpc::ServerUnaryReactor* Stall(const std::string& method) {
    auto* const reactor = new Reactor;
    on_call_(method);
    return reactor;
  }
  grpc::ServerUnaryReactor* GetServerInfo(grpc::CallbackServerContext* context, const v1::GetServerInfoRequest*,
                                          v1::ServerInfo*) override {
    if (has_given_info_.exchange(true)) return Stall("GetServerInfo");
    grpc::ServerUnaryReactor* const reactor = context->DefaultReactor();
    reactor->Finish(grpc::Status::OK);
    return reactor;
  }
  grpc::ServerUnaryReactor* Drain(grpc::CallbackServerContext*, const v1::DrainRequest*, v1::DrainResponse*) override {
    return Stall("Drain");
  }
  grpc::ServerUnaryReactor* SetLogLevel(grpc::CallbackServerContext*, const v1::SetLogLevelRequest*,
                                        v1::SetLogLevelResponse*) override {
    return Stall("SetLogLevel");
  }
  grpc::ServerUnaryReactor* ListModels(grpc::CallbackServerContext*, const v1::ListModelsRequest*,
                                       v1::ListModelsResponse*) override {
    return Stall("ListModels");
  }
  grpc::ServerUnaryReactor* DeleteModel(grpc::CallbackServerContext*, const v1::DeleteModelRequest*,
                                        google::protobuf::Empty*) override {
    return Stall("DeleteModel");
  }
  grpc::ServerUnaryReactor* GetModel(grpc::CallbackServerContext*, const v1::GetModelRequest*, v1::Model*) override {
    return Stall("GetModel");
  }
  grpc::ServerUnaryReactor* GetModelGeometry(grpc::CallbackServerContext*, const v1::GetModelGeometryRequest*,
                                             v1::ModelGeometry*) override {
    return Stall("GetModelGeometry");
  }
  grpc::ServerUnaryReactor* GetSession(grpc::CallbackServerContext*, const v1::GetSessionRequest*,
                                       v1::Session*) override {
    return Stall("GetSession");
  }
  grpc::ServerUnaryReactor* CreateSession(grpc::CallbackServerContext*, const v1::CreateSessionRequest*,
                                          v1::CreateSessionResponse*) override {
    return Stall("CreateSession");
  }
  grpc::ServerUnaryReactor* ListSessions(grpc::CallbackServerContext*, const v1::ListSessionsRequest*,
                                         v1::ListSessionsResponse*) override {
    return Stall("ListSessions");
  }
  grpc::ServerWriteReactor<v1::WatchHealthResponse>* WatchHealth(grpc::CallbackServerContext*,
                                                                 const v1::WatchHealthRequest*) override {
    auto* const reactor = new HealthReactor;
    on_call_("WatchHealth");
    return reactor;
  }

  const std::function<void(const std::string&)> on_call_;
  int port_ = 0;
  std::atomic<bool> has_given_info_ = false;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<Client> client_;
};

}  // namespace evpose::client
