// SPDX-License-Identifier: Apache-2.0

// Where a Redis server is, and who asks.
#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace evpose::server {

struct RedisAddress {
  std::string host;  // empty: `socket_path`
  int port = 6379;
  std::string socket_path;
  int database = 0;
  std::string user;
  std::string password;

  // Without the password: for logs and errors.
  std::string Printable() const;
};

// redis://[[USER:]PASSWORD@]HOST[:PORT][/DATABASE], with %XX for what has a meaning there, or
// redis+unix://[[USER:]PASSWORD@]/PATH. Errors, which never show what stands before the @: INVALID_ARGUMENT;
// UNIMPLEMENTED for rediss://, which Debian 12's hiredis does not speak.
absl::StatusOr<RedisAddress> ParseRedisAddress(absl::string_view url);

}  // namespace evpose::server
