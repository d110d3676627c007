// SPDX-License-Identifier: Apache-2.0

// Tells a load balancer how much work it should give to this server, as HAProxy's agent-check reads it.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "absl/status/statusor.h"

namespace evpose::server {

// The line that agent-check reads: the weight of the server as a percentage of its configured weight, "75%\n" at a load
// of 0.25. At least 1 %, because 0 % would be an order to drain the server.
std::string AgentLine(double load_ratio);

// Sends one line to each connection and closes it, without reading. HAProxy cannot set a weight from a page of HTTP.
class LoadListener {
 public:
  // `make_line` is called on the thread of the listener and must neither block nor throw. `listen_address` is
  // HOST:PORT; port 0 chooses a free port. Errors: INVALID_ARGUMENT for a malformed address; UNAVAILABLE, with cause
  // and remedy, when the server cannot listen on it.
  static absl::StatusOr<std::unique_ptr<LoadListener>> Start(const std::string& listen_address,
                                                             std::function<std::string()> make_line);
  // `make_line` is not called afterwards.
  virtual ~LoadListener() = default;

  virtual int port() const = 0;
};

}  // namespace evpose::server
