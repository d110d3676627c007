// SPDX-License-Identifier: Apache-2.0

// Redis servers for tests.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "server/stores/redis/redis_address.h"
#include "server/stores/redis/redis_connection.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {

// A process of redis-server, which is killed when the object is destroyed or the thread that called Start() ends.
class RedisProcess {
 public:
  RedisProcess() = default;
  ~RedisProcess() { Kill(); }
  RedisProcess(const RedisProcess&) = delete;
  RedisProcess& operator=(const RedisProcess&) = delete;

  // Starts redis-server and waits until it has logged a line that contains `ready`. UNAVAILABLE, with what it has
  // logged, if it has ended before.
  absl::Status Start(std::vector<std::string> arguments, const std::string& ready);
  // Sends SIGKILL and waits for the end.
  void Kill();
  // Sends a signal, for example SIGSTOP or SIGCONT.
  void Signal(int signal) const;

 private:
  pid_t process_ = -1;
};

// All keys with their values, as DUMP returns them.
using RedisContents = std::vector<std::pair<std::string, std::string>>;

// Runs redis-server in a temporary directory.
class RedisServer {
 public:
  enum class Listens { kOnSocket, kOnPortToo };

  // Starts the server and waits until it is ready. `options` are added to the command line of redis-server.
  // `password` is that of Run().
  explicit RedisServer(const std::vector<std::string>& options = {}, const std::string& password = "",
                       Listens listens = Listens::kOnSocket);

  std::string url(const std::string& user = "") const { return "redis+unix://" + user + directory_.path() + "/socket"; }
  std::string path(const std::string& file) const { return directory_.path() + "/" + file; }
  // The port of the loopback interface, which was free at the first start; 0 without a port.
  int port() const { return port_; }

  // Kill() sends SIGKILL; Start() starts the server again on the same data, with the same options and these.
  void Kill() { process_.Kill(); }
  void Start(const std::vector<std::string>& options = {}) { EXPECT_EQ(TryStart(options), absl::OkStatus()); }
  absl::Status TryStart(const std::vector<std::string>& options = {});
  void Signal(int signal) const { process_.Signal(signal); }

  // Returns all keys with their values, read in one script, so that they belong to the same instant.
  RedisContents Contents() const;
  // Replaces all keys, as a replica does that had missed the last writes and became the master.
  void Replace(const RedisContents& contents) const;

  // Runs a command on a new connection.
  RedisReply Run(const RedisCommand& command) const;
  std::string Text(const RedisCommand& command) const { return RedisText(Run(command).get()); }

 private:
  const TemporaryDirectory directory_;
  const std::vector<std::string> options_;
  const std::string password_;
  int port_ = 0;
  RedisProcess process_;
};

// A connection on which the server continues to send after a command: MONITOR, PSUBSCRIBE.
class RedisFeed {
 public:
  // `address` has a socket. The command has been executed when the constructor returns.
  RedisFeed(const RedisAddress& address, const RedisCommand& command);

  // Waits for the next message without a limit and returns its text, which is empty for a list. Throws
  // std::runtime_error when the server has closed the connection.
  std::string Next();

 private:
  struct ContextDeleter {
    void operator()(redisContext* context) const { redisFree(context); }
  };
  const std::unique_ptr<redisContext, ContextDeleter> context_;
};

// A master with two replicas, and three Sentinels that replace the master after some time without a reply.
class RedisGroup {
 public:
  static constexpr char kName[] = "evpose";

  struct Options {
    std::string password;  // if not empty, all processes require it
    // Time without a reply of the master after which it is replaced. With the default a busy machine causes no
    // failover.
    absl::Duration down_after = absl::Minutes(5);
  };

  // Starts all processes and waits until the replicas follow the master.
  explicit RedisGroup(const Options& options);
  RedisGroup() : RedisGroup(Options()) {}

  // The address for --store. `user` ends with an @.
  std::string url(const std::string& user = "", const std::string& name = kName) const;
  size_t num_nodes() const { return nodes_.size(); }
  RedisServer& node(size_t i) { return *nodes_[i]; }
  RedisServer& master() { return node(Master()); }

  // The number of the node that a Sentinel names as the master.
  size_t Master(size_t sentinel = 0) const;
  // Changes Options::down_after.
  void SetDownAfter(absl::Duration down_after) const;
  // Waits until the Sentinels know each other and all replicas, so that they can replace the master.
  void AwaitSentinels() const;
  // Waits until this number of replicas follow the node that a Sentinel names as the master.
  void AwaitReplicas(int64_t count) const;
  // Waits until the Sentinels name another node than `old_master`, and it is a master with a replica; returns it.
  size_t AwaitFailover(size_t old_master) const;
  // Kills the master and gives both replicas these earlier contents of it, as if they had missed the later writes.
  // Waits until the Sentinels have made one of them the master; returns it.
  size_t PromoteStale(const RedisContents& contents) const;
  // Starts a killed node as a replica of the present master, and waits until all nodes follow it.
  void Restart(size_t node);
  // Makes the first Sentinel monitor a node as the master of another name, which only this Sentinel knows.
  void Monitor(const std::string& name, size_t node) const;
  // Kills the first `count` Sentinels.
  void KillSentinels(size_t count);

 private:
  struct Sentinel {
    TemporaryDirectory directory;
    RedisProcess process;
    int port = 0;
  };
  void StartNode();
  void StartSentinel();
  std::string ConfigurationOf(const Sentinel& sentinel) const;
  RedisAddress AddressOf(size_t sentinel) const;
  RedisReply Ask(size_t sentinel, const RedisCommand& command) const;
  // Waits until a condition is true, which is evaluated now and after each event that the Sentinel publishes.
  void Await(size_t sentinel, const std::function<bool()>& condition) const;
  // Waits until this number of replicas follow a node. False if it is not a master, or no longer.
  bool IsFollowedBy(int64_t count, size_t node) const;

  const Options options_;
  std::vector<std::unique_ptr<RedisServer>> nodes_;
  std::vector<std::unique_ptr<Sentinel>> sentinels_;
};

}  // namespace evpose::server
