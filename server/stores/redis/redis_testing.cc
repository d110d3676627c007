// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_testing.h"

#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <fstream>
#include <random>
#include <stdexcept>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/base/poll_testing.h"

namespace evpose::server {

namespace {

// Calls `start` with ports of the loopback interface until one is free, and returns that. They are below the range from
// which the kernel takes ports for connections, so that they stay free while a killed server is started again. Only the
// server itself can find out whether a port is free: a test that runs at the same time may take it at any moment.
int StartOnFreePort(const std::function<absl::Status(int)>& start) {
  constexpr int kFirst = 10000;
  constexpr int kLast = 32000;
  std::random_device random;
  std::uniform_int_distribution<int> draw(kFirst, kLast);
  while (true) {
    const int port = draw(random);
    const absl::Status started = start(port);
    if (absl::StrContains(started.message(), "Address already in use")) continue;
    EXPECT_EQ(started, absl::OkStatus());
    return port;
  }
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

absl::Status RedisProcess::Start(std::vector<std::string> arguments, const std::string& ready) {
  arguments.insert(arguments.begin(), "redis-server");
  std::vector<char*> words;
  for (std::string& argument : arguments) words.push_back(argument.data());
  words.push_back(nullptr);
  int log[2];
  if (pipe(log) != 0) return absl::UnavailableError("there is no pipe left for the output of redis-server");
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
  std::string output;
  while (!is_ready && std::fgets(line, sizeof(line), lines) != nullptr) {
    output += line;
    is_ready = absl::StrContains(line, ready);
  }
  // Later output is not read: it fits into the buffer of the pipe or is lost.
  std::fclose(lines);
  if (is_ready) return absl::OkStatus();
  Kill();
  return absl::UnavailableError(
      absl::StrCat("redis-server (deploy/install-dependencies.sh --test) did not start: ", output));
}

void RedisProcess::Kill() {
  if (process_ <= 0) return;
  kill(process_, SIGKILL);
  waitpid(process_, nullptr, 0);
  process_ = -1;
}

void RedisProcess::Signal(int signal) const { kill(process_, signal); }

RedisServer::RedisServer(const std::vector<std::string>& options, const std::string& password, Listens listens)
    : options_(options), password_(password) {
  if (listens == Listens::kOnSocket) {
    Start();
    return;
  }
  StartOnFreePort([this](int port) {
    port_ = port;
    return TryStart();
  });
}

absl::Status RedisServer::TryStart(const std::vector<std::string>& options) {
  // Replies are sent after the commit is in the file, because tests kill the server and expect its data.
  std::vector<std::string> words = {
      "--port", std::to_string(port_), "--unixsocket", path("socket"),  "--dir", directory_.path(), "--save",
      "",       "--appendonly",        "yes",          "--appendfsync", "always"};
  words.insert(words.end(), options_.begin(), options_.end());
  words.insert(words.end(), options.begin(), options.end());
  return process_.Start(std::move(words), "eady to accept connections");
}

RedisContents RedisServer::Contents() const {
  // A script, because a server may write meanwhile.
  const RedisReply list = Run({"EVAL",
                               "local all = {} for _, key in ipairs(redis.call('KEYS', '*')) do all[#all + 1] = key "
                               "all[#all + 1] = redis.call('DUMP', key) end return all",
                               "0"});
  RedisContents contents;
  for (size_t i = 0; i + 1 < list->elements; i += 2) {
    contents.emplace_back(RedisText(list->element[i]), RedisText(list->element[i + 1]));
  }
  return contents;
}

void RedisServer::Replace(const RedisContents& contents) const {
  Run({"FLUSHALL"});
  for (const auto& [key, value] : contents) EXPECT_EQ(Text({"RESTORE", key, "0", value}), "OK");
}

RedisReply RedisServer::Run(const RedisCommand& command) const {
  return RunOn(url(password_.empty() ? "" : password_ + "@"), command);
}

RedisFeed::RedisFeed(const RedisAddress& address, const RedisCommand& command)
    : context_(redisConnectUnix(address.socket_path.c_str())) {
  std::vector<RedisCommand> commands;
  if (!address.password.empty()) commands.push_back({"AUTH", address.password});
  commands.push_back(command);
  for (const RedisCommand& words : commands) {
    std::vector<const char*> arguments;
    for (const std::string& word : words) arguments.push_back(word.c_str());
    redisAppendCommandArgv(context_.get(), static_cast<int>(arguments.size()), arguments.data(), nullptr);
    Next();
  }
}

std::string RedisFeed::Next() {
  void* read = nullptr;
  if (redisGetReply(context_.get(), &read) != REDIS_OK) throw std::runtime_error(context_->errstr);
  const RedisReply reply(static_cast<redisReply*>(read));
  EXPECT_NE(reply->type, REDIS_REPLY_ERROR) << RedisText(reply.get());
  return RedisText(reply.get());
}

RedisGroup::RedisGroup(const Options& group_options) : options_(group_options) {
  for (size_t i = 0; i < 3; ++i) StartNode();
  EXPECT_TRUE(IsFollowedBy(2, 0));
  for (size_t i = 0; i < 3; ++i) StartSentinel();
}

void RedisGroup::StartNode() {
  // What a killed process has written stays in the page cache. Waiting for the disk would stop a server for longer than
  // the Sentinels tolerate. A replica that a busy machine or SIGSTOP stops is still a replica.
  std::vector<std::string> options = absl::StrSplit(
      "--bind 127.0.0.1 --min-replicas-to-write 1 --min-replicas-max-lag 3600 --repl-timeout 3600"
      " --repl-diskless-sync-delay 0 --appendfsync no",
      ' ');
  const std::string& password = options_.password;
  if (!password.empty()) options.insert(options.end(), {"--requirepass", password, "--masterauth", password});
  nodes_.push_back(std::make_unique<RedisServer>(options, password, RedisServer::Listens::kOnPortToo));
  if (nodes_.size() > 1) nodes_.back()->Run({"REPLICAOF", "127.0.0.1", std::to_string(nodes_[0]->port())});
}

void RedisGroup::StartSentinel() {
  sentinels_.push_back(std::make_unique<Sentinel>());
  Sentinel& sentinel = *sentinels_.back();
  const std::string file = sentinel.directory.path() + "/sentinel.conf";
  StartOnFreePort([&](int port) {
    sentinel.port = port;
    std::ofstream(file) << ConfigurationOf(sentinel);
    return sentinel.process.Start({file, "--sentinel"}, "+monitor master");
  });
  // Shorter periods make a failover faster. A busy machine must not make a Sentinel stop for 30 s (TILT).
  Ask(sentinels_.size() - 1, {"SENTINEL", "DEBUG", "INFO-PERIOD", "200", "ASK-PERIOD", "200", "PUBLISH-PERIOD", "200",
                              "TILT-TRIGGER", "60000"});
}

std::string RedisGroup::ConfigurationOf(const Sentinel& sentinel) const {
  const std::string& directory = sentinel.directory.path();
  const int64_t down_after_ms = absl::ToInt64Milliseconds(options_.down_after);
  std::string lines =
      absl::StrCat("port ", sentinel.port, "\nbind 127.0.0.1\ndir ", directory, "\nunixsocket ", directory,
                   "/socket\nsentinel monitor ", kName, " 127.0.0.1 ", nodes_[0]->port(), " 2\n");
  absl::StrAppend(&lines, "sentinel down-after-milliseconds ", kName, " ", down_after_ms, "\n");
  // The Sentinels repeat a failed failover after twice this time.
  absl::StrAppend(&lines, "sentinel failover-timeout ", kName, " 3000\n");
  if (options_.password.empty()) return lines;
  absl::StrAppend(&lines, "requirepass ", options_.password, "\nsentinel sentinel-pass ", options_.password, "\n");
  absl::StrAppend(&lines, "sentinel auth-pass ", kName, " ", options_.password, "\n");
  return lines;
}

std::string RedisGroup::url(const std::string& user, const std::string& name) const {
  std::string hosts;
  for (size_t i = 0; i < 3; ++i) absl::StrAppend(&hosts, i == 0 ? "" : ",", "127.0.0.1:", sentinels_[i]->port);
  return absl::StrCat("redis+sentinel://", user, hosts, "/", name);
}

RedisAddress RedisGroup::AddressOf(size_t sentinel) const {
  RedisAddress address;
  address.socket_path = sentinels_[sentinel]->directory.path() + "/socket";
  address.password = options_.password;
  return address;
}

RedisReply RedisGroup::Ask(size_t sentinel, const RedisCommand& command) const {
  const RedisAddress address = AddressOf(sentinel);
  auto connection = RedisConnection::Connect(address, "the Sentinel", absl::Seconds(60)).value();
  EXPECT_TRUE(connection->Authenticate(address).ok());
  return connection->Run(command).value();
}

void RedisGroup::Await(size_t sentinel, const std::function<bool()>& condition) const {
  RedisFeed events(AddressOf(sentinel), {"PSUBSCRIBE", "*"});
  while (!condition()) events.Next();
}

size_t RedisGroup::Master(size_t sentinel) const {
  const RedisReply reply = Ask(sentinel, {"SENTINEL", "GET-MASTER-ADDR-BY-NAME", kName});
  const std::string port = reply->elements == 2 ? RedisText(reply->element[1]) : "";
  size_t node = 0;
  while (node < nodes_.size() && std::to_string(nodes_[node]->port()) != port) ++node;
  EXPECT_LT(node, nodes_.size()) << "the Sentinel names port " << port;
  return node;
}

void RedisGroup::SetDownAfter(absl::Duration down_after) const {
  const std::string down_after_ms = std::to_string(absl::ToInt64Milliseconds(down_after));
  for (size_t i = 0; i < sentinels_.size(); ++i) {
    Ask(i, {"SENTINEL", "SET", kName, "down-after-milliseconds", down_after_ms});
  }
}

void RedisGroup::AwaitSentinels() const {
  for (size_t i = 0; i < sentinels_.size(); ++i) {
    // Only what a Sentinel publishes when it changes.
    Await(i, [&] {
      const RedisReply reply = Ask(i, {"SENTINEL", "MASTER", kName});
      const std::string flags = FieldOf(reply, "flags");
      return FieldOf(reply, "num-slaves") == "2" && FieldOf(reply, "num-other-sentinels") == "2" &&
             !absl::StrContains(flags, "down") && !absl::StrContains(flags, "failover");
    });
  }
}

size_t RedisGroup::AwaitFailover(size_t old_master) const {
  size_t master = old_master;
  for (size_t i = 0; i < sentinels_.size(); ++i) {
    Await(i, [&] { return (master = Master(i)) != old_master && IsFollowedBy(1, master); });
  }
  return master;
}

size_t RedisGroup::PromoteStale(const RedisContents& contents) const {
  const size_t old_master = Master();
  nodes_[old_master]->Kill();
  for (size_t i = 0; i < nodes_.size(); ++i) {
    if (i == old_master) continue;
    // It has then read everything that the master has sent.
    EXPECT_TRUE(Poll([&] { return RedisTextAt(nodes_[i]->Run({"ROLE"}).get(), 3) != "connected"; }));
    nodes_[i]->Run({"CONFIG", "SET", "replica-read-only", "no"});
    nodes_[i]->Replace(contents);
    nodes_[i]->Run({"CONFIG", "SET", "replica-read-only", "yes"});
  }
  SetDownAfter(absl::Seconds(1));
  const size_t master = AwaitFailover(old_master);
  SetDownAfter(options_.down_after);
  return master;
}

void RedisGroup::AwaitReplicas(int64_t count) const {
  Await(0, [&] { return IsFollowedBy(count, Master()); });
}

bool RedisGroup::IsFollowedBy(int64_t count, size_t node) const {
  RedisAddress address = ParseRedisAddress(nodes_[node]->url()).value();
  address.password = options_.password;
  const auto connection = RedisConnection::Open(address, absl::Seconds(60));
  if (!connection.ok()) return false;
  while (true) {
    const auto reply = (*connection)->Run({"WAIT", std::to_string(count), "50000"});
    if (!reply.ok()) return false;
    if ((*reply)->integer >= count) return true;
  }
}

void RedisGroup::Restart(size_t node) {
  const std::string master_port = std::to_string(nodes_[Master()]->port());
  ASSERT_EQ(nodes_[node]->TryStart({"--replicaof", "127.0.0.1", master_port}), absl::OkStatus());
  AwaitReplicas(2);
  AwaitSentinels();
}

void RedisGroup::Monitor(const std::string& name, size_t node) const {
  Ask(0, {"SENTINEL", "MONITOR", name, "127.0.0.1", std::to_string(nodes_[node]->port()), "2"});
}

void RedisGroup::KillSentinels(size_t count) {
  for (size_t i = 0; i < count; ++i) sentinels_[i]->process.Kill();
}

}  // namespace evpose::server
