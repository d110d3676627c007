// SPDX-License-Identifier: Apache-2.0

// PostgreSQL servers for tests.
#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "core/base/temporary_directory_testing.h"
#include "server/stores/postgres/postgres_connection.h"

namespace evpose::server {

// Runs a PostgreSQL server in a temporary directory, on a socket there. Its superuser is `evpose`, without a password;
// the user `keyed` needs one. PostgreSQL rejects root, so that for root the server belongs to the user `nobody`.
class PostgresServer {
 public:
  // Starts a server on an empty cluster and waits until it is ready. `settings` are of the form NAME=VALUE.
  explicit PostgresServer(const std::vector<std::string>& settings = {});
  // Starts a standby of `primary`, which names itself `standby`.
  struct StandbyOf {
    const PostgresServer& primary;
  };
  explicit PostgresServer(StandbyOf standby);
  ~PostgresServer();
  PostgresServer(const PostgresServer&) = delete;
  PostgresServer& operator=(const PostgresServer&) = delete;

  // The address of the database. `user` may contain a password.
  std::string url(const std::string& user = "evpose", const std::string& database = "postgres") const {
    return "postgresql://" + user + "@/" + database + "?host=" + directory_.path();
  }
  // The directory of the socket, which is the server's host.
  const std::string& host() const { return directory_.path(); }

  // Sends SIGKILL to the server's first process, and waits until the others have seen it and ended.
  void Kill();
  // Ends the server in order: it closes all connections.
  void Stop();
  // Starts the server again on the same data.
  void Start();

  // Makes commits wait for a standby of this name; empty: for none.
  void SetSynchronous(const std::string& standby) const;
  // The same, and waits until that standby follows.
  void AwaitSynchronous(const std::string& standby) const;

  // Runs statements as the superuser on a new connection; returns the first value of the last one as text.
  std::string Run(const std::string& sql) const;

 private:
  void Signal(int signal);
  std::string data() const { return directory_.path() + "/data"; }

  const TemporaryDirectory directory_;
  std::vector<std::string> settings_;
  pid_t process_ = -1;
  int end_ = -1;
};

}  // namespace evpose::server
