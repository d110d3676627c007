// SPDX-License-Identifier: Apache-2.0

// The caller of a call.
#pragma once

#include <string>

#include "absl/time/time.h"

namespace evpose::server {

struct Caller {
  std::string tenant;        // the call may access sessions and models of this tenant; "" without authentication
  bool is_operator = false;  // may drain the server, set its log level, and read totals over all tenants
  std::string peer;          // address of the client, for the log
  absl::Time expires = absl::InfiniteFuture();  // end of the validity of the client's certificate

  friend bool operator==(const Caller&, const Caller&) = default;
};

}  // namespace evpose::server
