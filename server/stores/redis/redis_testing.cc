// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_testing.h"

#include <arpa/inet.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <fstream>
#include <random>
#include <thread>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace evpose::server {

namespace {

// Returns ports of the loopback interface on which nothing listens. They are below the range from which the kernel
// takes ports for connections, so that they stay free while a killed server is started again.
std::vector<int> FreePorts(size_t count) {
  constexpr int kFirst = 10000;
  constexpr int kLast = 32000;
  std::random_device random;
  std::uniform_int_distribution<int> draw(kFirst, kLast);
  std::vector<int> ports;
  std::vector<int> sockets;
  while (ports.size() < count) {
    const int port = draw(random);
    sockets.push_back(socket(AF_INET, SOCK_STREAM, 0));
    sockaddr_in address = {};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port = htons(static_cast<uint16_t>(port));
    const auto* const bytes = reinterpret_cast<const sockaddr*>(&address);
    if (bind(sockets.back(), bytes, sizeof(address)) == 0) ports.push_back(port);
  }
  for (const int socket : sockets) close(socket);
  return ports;
}

// Returns the value of a field in a reply that lists names and values.
std::string FieldOf(const RedisReply& reply, absl::string_view name) {
  for (size_t i = 0; i + 1 < reply->elements; i += 2) {
    if (RedisText(reply->element[i]) == name) return RedisText(reply->element[i + 1]);
  }
  return "";
}

RedisReply RunOn(const std::string& url, const RedisCommand& command) {
  auto connection = RedisConnection::Open(ParseRedisAddress(url).value(), absl::Seconds(60)).value();
  return connection->Run(command).value();
}

}  // namespace

void RedisProcess::Start(std::vector<std::string> arguments, const std::string& ready) {
  arguments.insert(arguments.begin(), "redis-server");
  std::vector<char*> words;
  for (std::string& argument : arguments) words.push_back(argument.data());
  words.push_back(nullptr);
  int log[2];
  ASSERT_EQ(pipe(log), 0);
  process_ = fork();
  if (process_ == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    dup2(log[1], STDOUT_FILENO);
    close(log[0]);
    close(log[1]);
    execvp(words[0], words.data());
    _exit(127);
  }
  close(log[1]);
  FILE* const lines = fdopen(log[0], "r");
  char line[1024];
  bool is_ready = false;
  std::string said;
  while (!is_ready && std::fgets(line, sizeof(line), lines) != nullptr) {
    said += line;
    is_ready = absl::StrContains(line, ready);
  }
  // Later output is not read: it fits into the buffer of the pipe or is lost.
  std::fclose(lines);
  EXPECT_TRUE(is_ready) << "redis-server (deploy/install-dependencies.sh --test) did not start: " << said;
}

void RedisProcess::Kill() {
  if (process_ <= 0) return;
  kill(process_, SIGKILL);
  waitpid(process_, nullptr, 0);
  process_ = -1;
}

void RedisProcess::Signal(int signal) const { kill(process_, signal); }

RedisServer::RedisServer(const std::vector<std::string>& options, const std::string& password)
    : options_(options), password_(password) {
  Start();
}

void RedisServer::Start(const std::vector<std::string>& options) {
  // Replies are sent after the commit is in the file, because tests kill the server and expect its data.
  std::vector<std::string> words = {"--port", "0", "--unixsocket", path("socket"), "--dir",         directory_.path(),
                                    "--save", "",  "--appendonly", "yes",          "--appendfsync", "always"};
  words.insert(words.end(), options_.begin(), options_.end());
  words.insert(words.end(), options.begin(), options.end());
  process_.Start(std::move(words), "eady to accept connections");
}

std::vector<std::pair<std::string, std::string>> RedisServer::Contents() const {
  std::vector<std::pair<std::string, std::string>> contents;
  const RedisReply keys = Run({"KEYS", "*"});
  for (size_t i = 0; i < keys->elements; ++i) {
    const std::string key = RedisText(keys->element[i]);
    contents.emplace_back(key, Text({"DUMP", key}));
  }
  return contents;
}

void RedisServer::Replace(const std::vector<std::pair<std::string, std::string>>& contents) const {
  Run({"FLUSHALL"});
  for (const auto& [key, value] : contents) EXPECT_EQ(Text({"RESTORE", key, "0", value}), "OK");
}

RedisReply RedisServer::Run(const RedisCommand& command) const {
  return RunOn(url(password_.empty() ? "" : password_ + "@"), command);
}

RedisGroup::RedisGroup(const Options& group_options) : options_(group_options), ports_(FreePorts(6)) {
  const std::string& password = options_.password;
  const std::string master_port = std::to_string(ports_[0]);
  for (size_t i = 0; i < 3; ++i) {
    // What a killed process has written stays in the page cache. Waiting for the disk would stop a server for longer
    // than the Sentinels tolerate.
    std::vector<std::string> options =
        absl::StrSplit(absl::StrCat("--port ", ports_[i], " --bind 127.0.0.1 --min-replicas-to-write 1",
                                    " --repl-diskless-sync-delay 0 --appendfsync no"),
                       ' ');
    if (!password.empty()) options.insert(options.end(), {"--requirepass", password, "--masterauth", password});
    nodes_.push_back(std::make_unique<RedisServer>(options, password));
    if (i > 0) nodes_[i]->Run({"REPLICAOF", "127.0.0.1", master_port});
  }
  AwaitReplicas(0);
  for (size_t i = 0; i < 3; ++i) {
    sentinels_.push_back(std::make_unique<Sentinel>());
    Sentinel& sentinel = *sentinels_.back();
    const std::string file = sentinel.directory.path() + "/sentinel.conf";
    std::ofstream(file) << ConfigurationOf(i);
    sentinel.process.Start({file, "--sentinel"}, "+monitor master");
    // Shorter periods make a failover faster. A busy machine must not make a Sentinel stop for 30 s (TILT).
    Ask(i, {"SENTINEL", "DEBUG", "INFO-PERIOD", "200", "ASK-PERIOD", "200", "PUBLISH-PERIOD", "200", "TILT-TRIGGER",
            "60000"});
  }
}

std::string RedisGroup::ConfigurationOf(size_t sentinel) const {
  const std::string directory = sentinels_[sentinel]->directory.path();
  const int64_t down_after_ms = absl::ToInt64Milliseconds(options_.down_after);
  std::string lines = absl::StrCat("port ", ports_[3 + sentinel], "\nbind 127.0.0.1\ndir ", directory, "\nunixsocket ",
                                   directory, "/socket\nsentinel monitor ", kName, " 127.0.0.1 ", ports_[0], " 2\n");
  absl::StrAppend(&lines, "sentinel down-after-milliseconds ", kName, " ", down_after_ms, "\n");
  absl::StrAppend(&lines, "sentinel failover-timeout ", kName, " ", 2 * down_after_ms, "\n");
  if (options_.password.empty()) return lines;
  absl::StrAppend(&lines, "requirepass ", options_.password, "\nsentinel sentinel-pass ", options_.password, "\n");
  absl::StrAppend(&lines, "sentinel auth-pass ", kName, " ", options_.password, "\n");
  return lines;
}

std::string RedisGroup::url(const std::string& user, const std::string& name) const {
  std::string hosts;
  for (size_t i = 0; i < 3; ++i) absl::StrAppend(&hosts, i == 0 ? "" : ",", "127.0.0.1:", ports_[3 + i]);
  return absl::StrCat("redis+sentinel://", user, hosts, "/", name);
}

RedisReply RedisGroup::Ask(size_t sentinel, const RedisCommand& command) const {
  RedisAddress address;
  address.socket_path = sentinels_[sentinel]->directory.path() + "/socket";
  address.password = options_.password;
  auto connection = RedisConnection::Connect(address, "the Sentinel", absl::Seconds(60)).value();
  EXPECT_TRUE(connection->Authenticate(address).ok());
  return connection->Run(command).value();
}

size_t RedisGroup::Master(size_t sentinel) const {
  const RedisReply reply = Ask(sentinel, {"SENTINEL", "GET-MASTER-ADDR-BY-NAME", kName});
  const std::string port = reply->elements == 2 ? RedisText(reply->element[1]) : "";
  size_t node = 0;
  while (node < nodes_.size() && std::to_string(ports_[node]) != port) ++node;
  EXPECT_LT(node, nodes_.size()) << "the Sentinel names port " << port;
  return node;
}

void RedisGroup::AwaitSentinels() const {
  for (size_t i = 0; i < sentinels_.size(); ++i) {
    const auto knows_all = [&] {
      const RedisReply reply = Ask(i, {"SENTINEL", "MASTER", kName});
      return FieldOf(reply, "num-slaves") == "2" && FieldOf(reply, "num-other-sentinels") == "2" &&
             FieldOf(reply, "flags") == "master";
    };
    while (!knows_all()) std::this_thread::yield();
  }
}

size_t RedisGroup::AwaitFailover(size_t old_master) const {
  size_t master = old_master;
  for (size_t i = 0; i < sentinels_.size(); ++i) {
    while ((master = Master(i)) == old_master) std::this_thread::yield();
  }
  while (RedisText(nodes_[master]->Run({"ROLE"})->element[0]) != "master") std::this_thread::yield();
  return master;
}

void RedisGroup::Restart(size_t node) {
  const size_t master = Master();
  nodes_[node]->Start({"--replicaof", "127.0.0.1", std::to_string(ports_[master])});
  AwaitReplicas(master);
  AwaitSentinels();
}

void RedisGroup::Monitor(const std::string& name, size_t node) const {
  Ask(0, {"SENTINEL", "MONITOR", name, "127.0.0.1", std::to_string(ports_[node]), "2"});
}

void RedisGroup::KillSentinels(size_t count) {
  for (size_t i = 0; i < count; ++i) sentinels_[i]->process.Kill();
}

void RedisGroup::AwaitReplicas(size_t master) const {
  EXPECT_EQ(nodes_[master]->Run({"WAIT", "2", "55000"})->integer, 2);
}

}  // namespace evpose::server
