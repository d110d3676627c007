// SPDX-License-Identifier: Apache-2.0

// A small HTTP server for pages that are made when they are asked for. Only the .cc file knows civetweb.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>

#include "absl/status/statusor.h"

namespace evpose::server {

struct HttpPage {
  int status = 200;
  std::string content_type = "text/plain; charset=utf-8";
  std::string body;
};

// Answers GET and HEAD of the pages it has, 404 for other paths, 405 for other methods. Reads no bodies, keeps no
// connection, and gives up on a client that takes its time.
class HttpServer {
 public:
  // Made by any of the server's threads, several at once; must not throw.
  using Pages = std::map<std::string, std::function<HttpPage()>>;  // by path: "/metrics"

  // HOST:PORT, IPv4 or a name that has such an address; port 0 takes a free one. Errors: INVALID_ARGUMENT for an
  // address that is none; UNAVAILABLE naming the address that cannot be listened on, why, and what to do.
  static absl::StatusOr<std::unique_ptr<HttpServer>> Start(const std::string& listen_address, Pages pages);
  // No page is made afterwards.
  virtual ~HttpServer() = default;

  virtual int port() const = 0;
};

}  // namespace evpose::server
