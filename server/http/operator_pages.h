// SPDX-License-Identifier: Apache-2.0

// What those who operate a server ask for over HTTP: /metrics, /healthz, /readyz. It tells no secrets, and asks nobody
// who they are.
#pragma once

#include <memory>
#include <mutex>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "core/base/version.h"
#include "server/http/http_server.h"
#include "server/rpc/server.h"

namespace evpose::server {

class OperatorPages {
 public:
  // Before there is a server, so that its start can be watched: until Show, it is not ready. Errors: those of
  // HttpServer::Start.
  static absl::StatusOr<std::unique_ptr<OperatorPages>> Start(const std::string& listen_address, BuildVersion build);

  // Of this server the pages tell from now on; it outlives them.
  void Show(const Server& server);
  int port() const { return http_->port(); }

 private:
  explicit OperatorPages(BuildVersion build) : build_(std::move(build)) {}
  HttpPage Metrics() const;
  HttpPage Readiness() const;
  const Server* server() const;

  const BuildVersion build_;
  mutable std::mutex mutex_;
  const Server* server_ ABSL_GUARDED_BY(mutex_) = nullptr;
  std::unique_ptr<HttpServer> http_;  // last: it ends first
};

}  // namespace evpose::server
