// SPDX-License-Identifier: Apache-2.0

// A server for tests. Its first calls for a model fail with UNAVAILABLE, as while the server cannot reach its store.
#pragma once

#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>

#include <atomic>
#include <functional>
#include <memory>
#include <utility>

#include "client/lib/client_access.h"
#include "evpose/client.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {

struct InterruptedServerOptions {
  bool knows_model = true;  // else GetModel fails with NOT_FOUND
  int num_failures = 1;     // number of the first calls of each method for a model that fail with UNAVAILABLE
  // Called by each call that fails with UNAVAILABLE, on a thread of gRPC.
  std::function<void()> on_failure = [] {};
};

// Has a client, and "sessions/1" with the object "cube" of the model "models/1": a triangle.
class InterruptedServer final : private v1::ModelService::Service, private v1::SessionService::Service {
 public:
  explicit InterruptedServer(InterruptedServerOptions options) : options_(std::move(options)) {
    grpc::ServerBuilder builder;
    builder.RegisterService(static_cast<v1::ModelService::Service*>(this));
    builder.RegisterService(static_cast<v1::SessionService::Service*>(this));
    server_ = builder.BuildAndStart();
    client_ = ClientAccess::OverChannel(server_->InProcessChannel({}), "test server");
  }
  Client& client() { return *client_; }

 private:
  grpc::Status GetSession(grpc::ServerContext*, const v1::GetSessionRequest*, v1::Session* session) override {
    session->set_name("sessions/1");
    v1::TrackedObject& object = *session->mutable_config()->add_objects();
    object.set_object_id("cube");
    object.set_model("models/1");
    return grpc::Status::OK;
  }
  grpc::Status GetModel(grpc::ServerContext*, const v1::GetModelRequest*, v1::Model* model) override {
    if (IsInterrupted(num_get_model_)) return {grpc::StatusCode::UNAVAILABLE, "interrupted"};
    if (!options_.knows_model) return {grpc::StatusCode::NOT_FOUND, "was not seen by this server"};
    model->set_file_name("cube.obj");
    model->set_diameter_m(3.0);
    return grpc::Status::OK;
  }
  grpc::Status GetModelGeometry(grpc::ServerContext*, const v1::GetModelGeometryRequest*,
                                v1::ModelGeometry* geometry) override {
    if (IsInterrupted(num_get_geometry_)) return {grpc::StatusCode::UNAVAILABLE, "interrupted"};
    for (const float coordinate : {0.0f, 0.0f, 0.0f, 3.0f, 0.0f, 0.0f, 0.0f, 4.0f, 0.0f}) {
      geometry->add_vertices_m(coordinate);
    }
    for (const uint32_t vertex : {0, 1, 2}) geometry->add_faces(vertex);
    return grpc::Status::OK;
  }

  bool IsInterrupted(std::atomic<int>& num_calls) {
    if (num_calls++ >= options_.num_failures) return false;
    options_.on_failure();
    return true;
  }

  const InterruptedServerOptions options_;
  std::atomic<int> num_get_model_ = 0;
  std::atomic<int> num_get_geometry_ = 0;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<Client> client_;
};

}  // namespace evpose::client
