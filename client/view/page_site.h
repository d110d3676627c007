// SPDX-License-Identifier: Apache-2.0

// Decides which HTTP requests are answered, and how. These rules keep other sites and other machines out.
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "client/view/page_server.h"
#include "server/connections/listen_address.h"

namespace evpose::client {

// Path of the WebSocket.
inline constexpr absl::string_view kStreamPath = "/stream";

// Returns whether a client with this header Accept-Encoding takes answers that are compressed with gzip.
bool AcceptsGzip(absl::string_view accept_encoding);
// Errors: INTERNAL if the bytes are not compressed with gzip; RESOURCE_EXHAUSTED without memory.
absl::StatusOr<std::string> Decompress(absl::string_view bytes);

// Immutable.
class PageSite {
 public:
  // Accepts the names of `address`, 127.0.0.1:PORT, localhost:PORT and `hosts` for the server.
  PageSite(absl::Span<const PageFile> files, const server::ListenAddress& address,
           const std::vector<std::string>& hosts, std::string key);

  // Returns HOST:PORT of `address`.
  const std::string& address() const { return hosts_.front(); }

  // Error: PERMISSION_DENIED for another host, such as a name that an attacker has let resolve to this machine (DNS
  // rebinding).
  absl::Status CheckHost(absl::string_view host) const;
  // Checks the origin of a WebSocket, because browsers open one for pages of any origin. Error: PERMISSION_DENIED
  // unless the origin is this site under the name `host`.
  absl::Status CheckOrigin(absl::string_view origin, absl::string_view host) const;
  bool IsKey(absl::string_view key) const;

  // Returns nullptr if there is no such file. A query in `target` is ignored.
  const PageFile* Find(absl::string_view target) const;
  // Returns the headers, as pairs of name and value, of all responses to requests for a permitted host.
  std::vector<std::pair<std::string, std::string>> Headers(absl::string_view host) const;

 private:
  const std::vector<PageFile> files_;
  std::vector<std::string> hosts_;  // in lower case
  const std::string key_;
};

}  // namespace evpose::client
