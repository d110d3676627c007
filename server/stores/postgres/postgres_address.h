// SPDX-License-Identifier: Apache-2.0

// The address of a PostgreSQL database and the credentials of the client.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace evpose::server {

struct PostgresAddress {
  // All parameters of the URI, in the names of libpq (host, port, dbname, user, password, sslmode, ...).
  std::vector<std::pair<std::string, std::string>> parameters;

  // The value of a parameter; empty if the address does not have it.
  std::string Get(absl::string_view name) const;
  // The address without user, password and other parameters, for logs and errors: postgresql://HOST:PORT,.../DATABASE.
  std::string Printable() const;
};

// True if `url` is that of a PostgreSQL database: it begins with postgresql:// or postgres://.
bool IsPostgresUrl(absl::string_view url);

// Parses a connection URI of libpq: postgresql://[USER[:PASSWORD]@]HOST[:PORT],.../DATABASE[?PARAMETER=VALUE&...]. The
// store needs a server that can be written: target_session_attrs becomes read-write, and must be read-write or primary
// if it is given. Errors: INVALID_ARGUMENT, which never contains user or password.
absl::StatusOr<PostgresAddress> ParsePostgresAddress(absl::string_view url);

// Inserts a password into `url`, which has none. `escaped_password` has each byte as %XX.
std::string WithPostgresPassword(absl::string_view url, absl::string_view escaped_password);

}  // namespace evpose::server
