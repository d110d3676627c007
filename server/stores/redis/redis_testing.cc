// SPDX-License-Identifier: Apache-2.0
#include "server/stores/redis/redis_testing.h"

#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>

#include "absl/strings/match.h"

namespace evpose::server {

RedisServer::RedisServer(const std::vector<std::string>& options) : options_(options) { Start(); }

RedisServer::~RedisServer() { Kill(); }

void RedisServer::Start() {
  // Replies are sent after the commit is in the file, because tests kill the server and expect its data.
  std::vector<std::string> words = {"redis-server",    "--port", "0", "--unixsocket", path("socket"), "--dir",
                                    directory_.path(), "--save", "",  "--appendonly", "yes",          "--appendfsync",
                                    "always"};
  words.insert(words.end(), options_.begin(), options_.end());
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  int log[2];
  ASSERT_EQ(pipe(log), 0);
  process_ = fork();
  if (process_ == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    dup2(log[1], STDOUT_FILENO);
    close(log[0]);
    close(log[1]);
    execvp(arguments[0], arguments.data());
    _exit(127);
  }
  close(log[1]);
  FILE* const lines = fdopen(log[0], "r");
  char line[1024];
  bool ready = false;
  std::string said;
  while (!ready && std::fgets(line, sizeof(line), lines) != nullptr) {
    said += line;
    ready = absl::StrContains(line, "eady to accept connections");
  }
  // Later output is not read: it fits into the buffer of the pipe or is lost.
  std::fclose(lines);
  EXPECT_TRUE(ready) << "redis-server (deploy/install-dependencies.sh --test) did not start: " << said;
}

void RedisServer::Kill() {
  if (process_ <= 0) return;
  kill(process_, SIGKILL);
  waitpid(process_, nullptr, 0);
  process_ = -1;
}

void RedisServer::Signal(int signal) const { kill(process_, signal); }

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
  auto connection = RedisConnection::Open(ParseRedisAddress(url()).value(), absl::Seconds(60)).value();
  return connection->Run(command).value();
}

}  // namespace evpose::server
