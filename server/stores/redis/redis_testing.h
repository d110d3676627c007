// SPDX-License-Identifier: Apache-2.0

// A Redis server for tests.
#pragma once

#include <sys/types.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "server/stores/redis/redis_address.h"
#include "server/stores/redis/redis_connection.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {

// Runs redis-server in a temporary directory until it is destroyed, or until the test program ends.
class RedisServer {
 public:
  // Starts the server and waits until it is ready. `options` are added to the command line of redis-server.
  explicit RedisServer(const std::vector<std::string>& options = {});
  ~RedisServer();
  RedisServer(const RedisServer&) = delete;
  RedisServer& operator=(const RedisServer&) = delete;

  std::string url(const std::string& user = "") const { return "redis+unix://" + user + directory_.path() + "/socket"; }
  std::string path(const std::string& file) const { return directory_.path() + "/" + file; }

  // Kill() sends SIGKILL; Start() starts the server again on the same data.
  void Kill();
  void Start();
  // Sends a signal, for example SIGSTOP or SIGCONT.
  void Signal(int signal) const;

  // All keys with their values, as DUMP returns them.
  std::vector<std::pair<std::string, std::string>> Contents() const;
  // Replaces all keys, as a replica does that had missed the last writes and became the master.
  void Replace(const std::vector<std::pair<std::string, std::string>>& contents) const;

  // Runs a command on a new connection.
  RedisReply Run(const RedisCommand& command) const;
  std::string Text(const RedisCommand& command) const { return RedisText(Run(command).get()); }

 private:
  const TemporaryDirectory directory_;
  const std::vector<std::string> options_;
  pid_t process_ = -1;
};

}  // namespace evpose::server
