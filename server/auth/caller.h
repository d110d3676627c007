// SPDX-License-Identifier: Apache-2.0

// Who calls.
#pragma once

#include <string>

namespace evpose::server {

struct Caller {
  std::string tenant;        // whose sessions and models the call may see; "" where nobody says who they are
  bool is_operator = false;  // may drain the server, and is told of all tenants together
  std::string peer;          // the address that the call comes from, for the log

  friend bool operator==(const Caller&, const Caller&) = default;
};

}  // namespace evpose::server
