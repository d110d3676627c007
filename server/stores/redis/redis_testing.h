// SPDX-License-Identifier: Apache-2.0

// A Redis server for tests, which goes with them.
#pragma once

#include <sys/types.h>

#include <memory>
#include <string>
#include <vector>

#include "server/stores/redis/redis_address.h"
#include "server/stores/redis/redis_connection.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {

class RedisServer {
 public:
  // Waits until it is ready. `options` as on redis-server's command line.
  explicit RedisServer(const std::vector<std::string>& options = {});
  ~RedisServer();
  RedisServer(const RedisServer&) = delete;
  RedisServer& operator=(const RedisServer&) = delete;

  std::string url(const std::string& user = "") const { return "redis+unix://" + user + directory_.path() + "/socket"; }
  std::string path(const std::string& file) const { return directory_.path() + "/" + file; }

  // SIGKILL, and again on the same data.
  void Kill();
  void Start();
  // SIGSTOP and SIGCONT.
  void Signal(int signal) const;

  // Runs a command on a connection of its own.
  RedisReply Run(const RedisCommand& command) const;
  std::string Text(const RedisCommand& command) const { return RedisText(Run(command).get()); }

 private:
  const TemporaryDirectory directory_;
  const std::vector<std::string> options_;
  pid_t process_ = -1;
};

}  // namespace evpose::server
