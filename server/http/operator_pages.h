// SPDX-License-Identifier: Apache-2.0

// The HTTP pages for the operator of a server: /metrics, /healthz, /readyz. They contain no secrets and need no
// authentication.
#pragma once

#include <atomic>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "core/base/version.h"
#include "server/http/http_server.h"
#include "server/rpc/server.h"

namespace evpose::server {

class OperatorPages {
 public:
  // Starts the HTTP server before the gRPC server exists, so that probes can observe the start: until Show(), /readyz
  // returns 503. Errors: those of HttpServer::Start().
  static absl::StatusOr<std::unique_ptr<OperatorPages>> Start(const std::string& listen_address, BuildVersion build);

  // From now on the pages show the state of `server`, which must outlive them.
  void Show(const Server& server) { server_ = &server; }
  int port() const { return http_->port(); }

 private:
  explicit OperatorPages(BuildVersion build) : build_(std::move(build)) {}
  HttpPage Metrics(const std::string& accept) const;
  HttpPage Readiness() const;

  const BuildVersion build_;
  std::atomic<const Server*> server_ = nullptr;
  std::unique_ptr<HttpServer> http_;  // the last member, so that it is destroyed first
};

}  // namespace evpose::server
