// SPDX-License-Identifier: Apache-2.0

// Serves the page and its WebSocket (client/view/README.md, sections 2 and 3).
#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "client/view/view_source.h"

namespace evpose::client {

// A file of the page. The views must outlive the server.
struct PageFile {
  absl::string_view path;  // "/", "/app.js"
  absl::string_view content_type;
  absl::string_view bytes;
  bool is_gzip = false;  // `bytes` are compressed
};

struct PageServerOptions {
  std::string listen = "127.0.0.1:0";  // HOST:PORT; port 0: a free one
  // Further values of the header Host that are accepted, beside 127.0.0.1:PORT, localhost:PORT and that of url():
  // "name" or "name:port".
  std::vector<std::string> hosts;
  // Longest time until a connection has sent its request, until it has received a further piece of the answer, until a
  // page has sent its key, and until a page has received a message. The connection is closed after it.
  std::chrono::milliseconds timeout{5000};
};

// Uses one thread, which never waits for a page.
class PageServer {
 public:
  static constexpr size_t kMaxPages = 8;            // each has streams or a thread for images of its own
  static constexpr size_t kMaxConnections = 64;     // including those of pages
  static constexpr size_t kMaxMessageBytes = 4096;  // of a message of the page
  static constexpr size_t kMaxRequestBytes = 8192;  // request line and headers

  // Listens. Browsers that connect before Serve() wait. Errors: INVALID_ARGUMENT for an invalid address; UNAVAILABLE
  // with the cause if the address cannot be listened on; INTERNAL if no random numbers are available.
  static absl::StatusOr<std::unique_ptr<PageServer>> Listen(const PageServerOptions& options,
                                                            absl::Span<const PageFile> files);
  // Begins to serve pages. To be called once. `source` must outlive the server.
  void Serve(ViewSource& source);
  // Closes all pages and waits for their views.
  ~PageServer();

  int port() const;
  // Returns the address with the key: http://HOST:PORT/#KEY, with the host of `listen`, or 127.0.0.1 if the server
  // listens on all addresses of the machine. Everyone who has it can see what the pages show.
  std::string url() const;
  // Sends `reason` to all pages as the end of the view.
  void End(const std::string& reason);

 private:
  class Impl;
  explicit PageServer(std::unique_ptr<Impl> impl);
  const std::unique_ptr<Impl> impl_;
};

}  // namespace evpose::client
