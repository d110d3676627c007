// SPDX-License-Identifier: Apache-2.0

// Tests evpose bench load with a server in a process of its own: counts, never times.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "client/bench/metrics_page.h"
#include "evpose/client.h"
#include "server/program/program_testing.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using client::Client;
using ::testing::HasSubstr;

// The address in a line such as "listening on 127.0.0.1:50051".
std::string AddressIn(const std::string& line) { return line.substr(line.rfind(' ') + 1); }

// A server that stores in memory, with its pages.
class LoadedServer {
 public:
  explicit LoadedServer(std::vector<std::string> more) : program_(Arguments(std::move(more))) {
    address_ = AddressIn(program_.ReadLine());
    metrics_ = AddressIn(program_.ReadLine());
  }
  const std::string& address() const { return address_; }
  const std::string& metrics() const { return metrics_; }

 private:
  static std::vector<std::string> Arguments(std::vector<std::string> more) {
    more.insert(more.end(), {"--listen", "127.0.0.1:0", "--metrics-listen", "127.0.0.1:0"});
    return more;
  }

  server::Program program_;
  std::string address_, metrics_;
};

class BenchLoadTest : public CliTest {
 protected:
  // A short test at a rate that every machine reaches.
  CliResult RunLoad(const std::string& address, const std::vector<std::string>& more) const {
    std::vector<std::string> arguments = {"bench", "load", "--server", address, "--rate", "5000", "--chunk-ms", "10"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Run(arguments);
  }
};

TEST_F(BenchLoadTest, CountsSessionsPosesAndRefusals) {
  const LoadedServer server({"--max-sessions", "2"});
  const CliResult result = RunLoad(server.address(), {"--sessions", "3", "--minutes", "0.02", "--watchers", "2",
                                                      "--metrics", server.metrics(), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json json = result.Json();
  EXPECT_GE(json["created"], 2);
  EXPECT_EQ(json["completed"], json["created"]);
  EXPECT_GE(json["refused"]["TOO_MANY_SESSIONS"], 1);
  EXPECT_TRUE(json["failed"].empty());
  EXPECT_EQ(json["unfinished"], 0);
  EXPECT_EQ(json["lost_poses"], 0);
  EXPECT_EQ(json["reconnections"], 0);
  EXPECT_GT(json["events"], 0);
  EXPECT_GT(json["poses"], 0);
  EXPECT_GT(json["watched_poses"], 0);
  EXPECT_LE(json["latency_p50_ms"], json["latency_p90_ms"]);
  EXPECT_LE(json["latency_p90_ms"], json["latency_p99_ms"]);
  EXPECT_LE(json["latency_p99_ms"], json["latency_max_ms"]);
  EXPECT_GT(json["cpu_s"], 0.0);
  ASSERT_EQ(json["servers"].size(), 1u);
  EXPECT_EQ(json["servers"][0]["metrics"], server.metrics());
  EXPECT_GT(json["servers"][0]["cpu_s"], 0.0);
  EXPECT_GT(json["servers"][0]["resident_mb_before"], 1.0);
  EXPECT_EQ(json["servers"][0]["load_ratio_after"], 1.0) << "two of two sessions";
  const auto client = Client::Connect(server.address());
  ASSERT_TRUE(client.ok()) << client.status();
  EXPECT_EQ((*client)->ListSessions()->size(), 0u) << "the bench deletes its sessions";
}

TEST_F(BenchLoadTest, SessionsAreReplaced) {
  const LoadedServer server({});
  const CliResult result =
      RunLoad(server.address(), {"--sessions", "2", "--minutes", "0.05", "--churn", "200", "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json json = result.Json();
  EXPECT_GT(json["created"], 2);
  EXPECT_EQ(json["completed"], json["created"]);
  EXPECT_EQ(json["lost_poses"], 0);
}

TEST_F(BenchLoadTest, PrintsATable) {
  const LoadedServer server({});
  const CliResult result = RunLoad(server.address(), {"--sessions", "1", "--minutes", "0.01"});
  ASSERT_EQ(result.status, 0) << result.err;
  for (const char* const row : {"sessions created       1 (1 completed)\n", "\nposes lost             0\n",
                                "\nlatency                p50 ", "\nCPU of this process "}) {
    EXPECT_THAT(result.out, HasSubstr(row));
  }
}

TEST_F(BenchLoadTest, ReportsServersThatTakeNoSession) {
  // Less than any session needs, so that waiting does not help.
  const LoadedServer server({"--max-session-memory", "1000000"});
  const CliResult full = RunLoad(server.address(), {"--sessions", "1", "--minutes", "0.01"});
  EXPECT_EQ(full.status, 1);
  EXPECT_THAT(full.err, HasSubstr("no session was created (SESSION_MEMORY 1)"));
  const CliResult away = RunLoad("127.0.0.1:9", {"--connect-timeout", "0.1"});
  EXPECT_EQ(away.status, 1);
  EXPECT_THAT(away.err, HasSubstr("127.0.0.1:9"));
  const CliResult blind = RunLoad(server.address(), {"--metrics", server.address()});
  EXPECT_EQ(blind.status, 1);
  EXPECT_THAT(blind.err, HasSubstr("--metrics-listen"));
  EXPECT_EQ(Run({"bench", "load", "--server", server.address(), "--rate", "10"}).status, 2);
}

TEST(MetricsPageTest, FindsMetricsWithoutLabels) {
  const std::string page =
      "# HELP evpose_a of this\n# TYPE evpose_a gauge\nevpose_a{b=\"c\"} 1\nevpose_ab 2\nevpose_a 3.5\n";
  EXPECT_EQ(client::MetricValue(page, "evpose_a").value(), 3.5);
  EXPECT_EQ(client::MetricValue(page, "evpose_ab").value(), 2.0);
  EXPECT_EQ(client::MetricValue(page, "evpose_b").status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(client::ReadServerUse("nonsense").status().code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace evpose
