// SPDX-License-Identifier: Apache-2.0

// The address of a Redis server and the credentials of the client.
#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace evpose::server {

struct RedisAddress {
  std::string host;  // empty: `socket_path` is used
  int port = 6379;
  std::string socket_path;
  int database = 0;
  std::string user;
  std::string password;

  // The address without user and password, for logs and errors.
  std::string Printable() const;
};

// Parses redis://[[USER:]PASSWORD@]HOST[:PORT][/DATABASE], with %XX for reserved characters in USER and PASSWORD, or
// redis+unix://[[USER:]PASSWORD@]/PATH. Errors, which never contain user or password: INVALID_ARGUMENT; UNIMPLEMENTED
// for rediss://, because Debian 12's hiredis has no TLS.
absl::StatusOr<RedisAddress> ParseRedisAddress(absl::string_view url);

}  // namespace evpose::server
