// SPDX-License-Identifier: Apache-2.0

// Which HTTP requests are answered, and how: the rules that keep other sites and other machines out.
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "client/view/page_server.h"

namespace evpose::client {

// Path of the WebSocket.
inline constexpr absl::string_view kStreamPath = "/stream";

// Immutable.
class PageSite {
 public:
  // The server is called 127.0.0.1:PORT, localhost:PORT or one of `hosts`.
  PageSite(absl::Span<const PageFile> files, int port, const std::vector<std::string>& hosts, std::string key);

  // Error: PERMISSION_DENIED for another host: a name of the attacker's that resolves to this machine (DNS rebinding).
  absl::Status CheckHost(absl::string_view host) const;
  // For the WebSocket, which browsers open for pages of any origin. Error: PERMISSION_DENIED unless the origin is this
  // site under the name `host`.
  absl::Status CheckOrigin(absl::string_view origin, absl::string_view host) const;
  bool IsKey(absl::string_view key) const;

  // nullptr if there is none. `target` may have a query, which is ignored.
  const PageFile* Find(absl::string_view target) const;
  // The headers of all responses for the permitted host, as name and value.
  std::vector<std::pair<std::string, std::string>> Headers(absl::string_view host) const;

 private:
  const std::vector<PageFile> files_;
  std::vector<std::string> hosts_;  // in lower case
  const std::string key_;
};

}  // namespace evpose::client
