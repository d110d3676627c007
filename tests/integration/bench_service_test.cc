// SPDX-License-Identifier: Apache-2.0

// Tests the rows and the errors of evpose bench speed with a server, with few repetitions of short recordings.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <sstream>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/bench/process_usage.h"
#include "client/cli/cli.h"
#include "client/cli/common/server_process.h"
#include "core/base/closed_port_testing.h"
#include "evpose/client.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using client::Client;
using client::ServerProcess;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

// Returns whether this process has a child process. Reaps one that has ended.
bool HasChildren() { return waitpid(-1, nullptr, WNOHANG) >= 0 || errno != ECHILD; }

class BenchServiceTest : public CliTest {
 protected:
  CliResult RunSpeed(const std::vector<std::string>& more) const {
    std::vector<std::string> arguments = {"bench", "speed", "--duration", "0.02", "--repetitions", "1"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Run(arguments);
  }
  // Runs the bench with the options `more` and returns the rows of its table.
  nlohmann::json Rows(std::vector<std::string> more) const {
    more.insert(more.end(), {"--out", Path("speed.json")});
    const CliResult result = RunSpeed(more);
    EXPECT_EQ(result.status, 0) << result.err;
    EXPECT_FALSE(HasChildren());
    nlohmann::json rows = nlohmann::json::parse(ReadText("speed.json"), nullptr, false)["rows"];
    for (const nlohmann::json& row : rows) {
      EXPECT_GT(row["events"], 0) << row;
      EXPECT_TRUE(row.contains(row["measure"].get<std::string>())) << row;
      EXPECT_THAT(result.out, HasSubstr(absl::StrCat("\n", row["part"].get<std::string>()))) << row;
    }
    return rows;
  }
  static std::vector<std::string> Column(const nlohmann::json& rows, const std::string& name) {
    std::vector<std::string> values;
    for (const nlohmann::json& row : rows) values.push_back(row[name]);
    return values;
  }
};

TEST_F(BenchServiceTest, PathIsComparedWithTheTrackerOfTheSameRun) {
  const nlohmann::json rows = Rows({"--parts", "path"});
  ASSERT_THAT(Column(rows, "scene"), ElementsAre("1", "10", "50"));
  for (const nlohmann::json& row : rows) {
    EXPECT_NEAR(row["tracker_ratio"].get<double>(),
                row["mev_per_s"].get<double>() / row["tracker_mev_per_s"].get<double>(), 1e-9);
    EXPECT_GT(row["client_cpu_s_per_gev"], 0.0);
    EXPECT_GT(row["server_cpu_s_per_gev"], 0.0);
    EXPECT_EQ(row["more_is_better"], true);
  }
}

TEST_F(BenchServiceTest, TransportMovesTheBytesAndLatencyIsInOrder) {
  const nlohmann::json rows = Rows({"--parts", "transport,latency"});
  ASSERT_THAT(Column(rows, "part"), ElementsAre("transport", "latency"));
  const nlohmann::json& latency = rows[1];
  EXPECT_GE(latency["poses"], 10);
  for (const char* const name : {"chunk", "window", "server"}) {
    EXPECT_LE(latency[absl::StrCat(name, "_p50_ms")], latency[absl::StrCat(name, "_p99_ms")]) << latency;
    EXPECT_LE(latency[absl::StrCat(name, "_p99_ms")], latency[absl::StrCat(name, "_max_ms")]) << latency;
  }
  // The last chunk of a window ends after the window, and its receipt arrives after the end of the chunk.
  EXPECT_GE(latency["window_p50_ms"], latency["chunk_p50_ms"]);
  EXPECT_GT(latency["chunk_p50_ms"], latency["server_p50_ms"]);
  EXPECT_GT(latency["server_p50_ms"], 0.0);
  EXPECT_GT(rows[0]["mb_per_s"], 0.0);
  EXPECT_GT(rows[0]["memcpy_ratio"], 1.0) << "decoding also copies";
}

TEST_F(BenchServiceTest, SessionsAndMemoryAreThoseOfAProcessOfItsOwn) {
  const nlohmann::json rows = Rows({"--parts", "sessions,memory"});
  ASSERT_THAT(Column(rows, "what"), ElementsAre("1", "4", "16", "64", "1+8", "1+8"));
  EXPECT_EQ(rows[0]["to_one_ratio"], 1.0);
  for (int i = 0; i < 4; ++i) {
    EXPECT_GT(rows[i]["to_one_ratio"], 0.0);
    EXPECT_GT(rows[i]["create_cpu_ms"], 0.0);
  }
  for (int i = 4; i < 6; ++i) {
    EXPECT_GT(rows[i]["mb_per_session"], 0.0);
    EXPECT_GT(rows[i]["server_mb"], 0.0);
    EXPECT_GT(rows[i]["first_session_mb"], 0.0);
  }
}

TEST_F(BenchServiceTest, AServerThatRunsIsUsed) {
  const auto server = ServerProcess::Start({});
  ASSERT_TRUE(server.ok()) << server.status();
  const std::vector<std::string> arguments = {"--parts", "path",        "--server", (*server)->address(),
                                              "--out",   Path("a.json")};
  const CliResult result = RunSpeed(arguments);
  ASSERT_EQ(result.status, 0) << result.err;
  EXPECT_FALSE(nlohmann::json::parse(ReadText("a.json"))["rows"][0].contains("server_cpu_s_per_gev"))
      << "the process of the server is unknown";
  std::vector<std::string> with_pid = arguments;
  with_pid.back() = Path("b.json");
  with_pid.insert(with_pid.end(), {"--server-pid", std::to_string((*server)->pid())});
  ASSERT_EQ(RunSpeed(with_pid).status, 0);
  EXPECT_GT(nlohmann::json::parse(ReadText("b.json"))["rows"][0]["server_cpu_s_per_gev"], 0.0);
  const auto client = Client::Connect((*server)->address());
  ASSERT_TRUE(client.ok()) << client.status();
  EXPECT_EQ((*client)->ListSessions()->size(), 0u) << "the bench deletes its sessions";
}

TEST_F(BenchServiceTest, ReportsPartsThatNeedALocalServer) {
  const auto fails = [&](const std::vector<std::string>& more, int status) {
    const CliResult result = RunSpeed(more);
    EXPECT_EQ(result.status, status) << result.out;
    EXPECT_FALSE(HasChildren());
    return result.err;
  };
  EXPECT_THAT(fails({"--parts", "memory", "--server", "127.0.0.1:9"}, 2), HasSubstr("leave out --server"));
  EXPECT_THAT(fails({"--parts", "sessions", "--server", "127.0.0.1:9"}, 2), HasSubstr("--server-pid"));
  EXPECT_THAT(fails({"--parts", "path", "--server-pid", "1"}, 2), HasSubstr("--server"));
  const ClosedPort closed;
  EXPECT_THAT(fails({"--parts", "path", "--server", closed.address(), "--server-pid", "4194304"}, 1),
              HasSubstr("no process 4194304"));
  EXPECT_THAT(fails({"--parts", "path", "--server", closed.address(), "--connect-timeout", "0.1"}, 1),
              HasSubstr(closed.address()));
}

TEST_F(BenchServiceTest, WithoutAServerTheErrorHasTheRemedy) {
  const CliResult result = RunShell(
      "cp \"$(command -v evpose)\" lonely\n"
      "PATH=/nowhere ./lonely bench speed --parts path --duration 0.01 --repetitions 1\n");
  EXPECT_EQ(result.status, 1);
  EXPECT_THAT(result.err, HasSubstr("there is no evpose-server beside"));
  EXPECT_THAT(result.err, HasSubstr("--server HOST:PORT"));
}

TEST_F(BenchServiceTest, AnInterruptEndsTheServerToo) {
  std::ostringstream out, err;
  client::CliContext context{out, err};
  // The signal arrives after the first row, while the server runs.
  context.is_interrupted = [&out] { return out.str().find("\npath") != std::string::npos; };
  const std::vector<std::string> arguments = {"bench", "speed",         "--parts", "path",  "--duration",
                                              "0.02",  "--repetitions", "1",       "--out", Path("speed.json")};
  EXPECT_EQ(client::RunCli(arguments, context), 1);
  EXPECT_THAT(err.str(), HasSubstr("interrupted"));
  EXPECT_FALSE(HasChildren());
  EXPECT_THAT(FilesBeginning("speed.json"), ::testing::IsEmpty());
}

TEST(ServerProcessTest, EndsWithItsOwner) {
  auto server = ServerProcess::Start({});
  ASSERT_TRUE(server.ok()) << server.status();
  EXPECT_GT(client::ProcessorSeconds((*server)->pid()).value(), 0.0);
  const client::ProcessMemory memory = client::MemoryOf((*server)->pid()).value();
  EXPECT_GT(memory.resident_mb, 1.0);
  EXPECT_GE(memory.peak_mb, memory.resident_mb);
  const pid_t pid = (*server)->pid();
  server->reset();
  EXPECT_FALSE(HasChildren());
  EXPECT_EQ(client::ProcessorSeconds(pid).status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(client::MemoryOf(pid).status().code(), absl::StatusCode::kNotFound);
}

TEST(ServerProcessTest, EndsWhenItsOwnersProcessIsKilled) {
  // The bench and its server hold the writing end: read() returns 0 when both have ended.
  int alive[2];
  ASSERT_EQ(pipe(alive), 0);
  const pid_t owner = fork();
  if (owner == 0) {
    const auto server = ServerProcess::Start({});
    if (write(alive[1], server.ok() ? "y" : "n", 1) == 1) pause();
    _exit(1);
  }
  close(alive[1]);
  char answer = 0;
  EXPECT_EQ(read(alive[0], &answer, 1), 1);
  EXPECT_EQ(answer, 'y');
  kill(owner, SIGKILL);
  waitpid(owner, nullptr, 0);
  EXPECT_EQ(read(alive[0], &answer, 1), 0) << "no process is left";
  close(alive[0]);
}

TEST(ServerProcessTest, ReportsAServerThatDoesNotListen) {
  const auto server = ServerProcess::Start({"--max-sessions", "none"});
  EXPECT_EQ(server.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(server.status().message()), HasSubstr("evpose-server has ended before it could be reached"));
  EXPECT_FALSE(HasChildren());
}

}  // namespace
}  // namespace evpose
