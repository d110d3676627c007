// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <csignal>
#include <memory>
#include <string>
#include <vector>

#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "server/program/program_testing.h"

namespace evpose {

// Adds the option for the pages of a server.
inline std::vector<std::string> WithMetrics(std::vector<std::string> arguments = {}) {
  arguments.insert(arguments.end(), {"--metrics-listen", "127.0.0.1:0"});
  return arguments;
}

// A server process and stubs connected to it.
class RunningServer {
 public:
  explicit RunningServer(const std::vector<std::string>& arguments, const char* program = EVPOSE_SERVER)
      : program_(WithAddress(arguments), program), address_(program_.Announced("listening on ")) {
    if (std::find(arguments.begin(), arguments.end(), "--metrics-listen") != arguments.end()) {
      metrics_address_ = program_.Announced("metrics on ");
    }
    channel_ = grpc::CreateChannel(address_, grpc::InsecureChannelCredentials());
    sessions_ = v1::SessionService::NewStub(channel_);
    models_ = v1::ModelService::NewStub(channel_);
  }

  void Kill() {
    program_.Signal(SIGKILL);
    program_.Wait();
  }
  server::Program& program() { return program_; }
  const std::string& address() const { return address_; }
  // Present with --metrics-listen.
  const std::string& metrics_address() const { return metrics_address_; }
  v1::SessionService::Stub& sessions() { return *sessions_; }
  v1::ModelService::Stub& models() { return *models_; }

 private:
  static std::vector<std::string> WithAddress(std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--listen", "127.0.0.1:0"});
    return arguments;
  }

  server::Program program_;
  const std::string address_;
  std::string metrics_address_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<v1::SessionService::Stub> sessions_;
  std::unique_ptr<v1::ModelService::Stub> models_;
};

}  // namespace evpose
