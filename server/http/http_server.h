// SPDX-License-Identifier: Apache-2.0

// A small HTTP server for generated pages. Only the .cc file uses Boost.Beast.
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

// Serves GET and HEAD requests for a fixed set of paths; other paths get 404, other methods 405. It reads no request
// bodies and closes the connection after each response. Connections that send nothing delay no other one: a connection
// has 5 s, and the oldest is closed when there are too many.
class HttpServer {
 public:
  // The functions that generate the pages, by path ("/metrics"), from the header Accept of the request: several are
  // joined by commas, and it is empty if there is none. They are called on the thread of the server and must neither
  // block nor throw.
  using Pages = std::map<std::string, std::function<HttpPage(const std::string& accept)>>;

  // `listen_address` is HOST:PORT; port 0 chooses a free port. Errors: INVALID_ARGUMENT for a malformed address;
  // UNAVAILABLE, with cause and remedy, when the server cannot listen on it.
  static absl::StatusOr<std::unique_ptr<HttpServer>> Start(const std::string& listen_address, Pages pages);
  // No page is generated afterwards.
  virtual ~HttpServer() = default;

  virtual int port() const = 0;
};

}  // namespace evpose::server
