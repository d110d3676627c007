// SPDX-License-Identifier: Apache-2.0

// The address of a Redis server, or of the Sentinels that name it, and the credentials of the client.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace evpose::server {

struct RedisHost {
  std::string host;
  int port = 0;

  // HOST:PORT, an IPv6 address in brackets.
  std::string Printable() const;
};

struct RedisAddress {
  std::string host;  // empty: `socket_path` or `sentinels` is used
  int port = 6379;
  std::string socket_path;
  // The Sentinels that know the address of the Redis server, which is the master `master_name`. Empty: the server's own
  // address is given.
  std::vector<RedisHost> sentinels;
  std::string master_name;
  int database = 0;
  std::string user;
  std::string password;

  // The address without user and password, for logs and errors.
  std::string Printable() const;
};

// Parses redis://[[USER:]PASSWORD@]HOST[:PORT][/DATABASE], with %XX for reserved characters in USER and PASSWORD,
// redis+unix://[[USER:]PASSWORD@]/PATH, or redis+sentinel://[[USER:]PASSWORD@]HOST[:PORT],.../NAME[/DATABASE] with
// the addresses of Sentinels (port 26379 if none is given) and the name of their master. Errors, which never contain
// user or password: INVALID_ARGUMENT; UNIMPLEMENTED for rediss:// and rediss+sentinel://, because Debian 12's hiredis
// has no TLS.
absl::StatusOr<RedisAddress> ParseRedisAddress(absl::string_view url);

}  // namespace evpose::server
