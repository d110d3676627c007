// SPDX-License-Identifier: Apache-2.0

// Tests evpose bench load with a server in a process of its own: counts, never times.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "client/bench/bench_session.h"
#include "client/bench/load_counts.h"
#include "client/bench/load_recording.h"
#include "client/bench/load_run.h"
#include "client/bench/metrics_page.h"
#include "core/base/closed_port_testing.h"
#include "core/events/decoder.h"
#include "evpose/client.h"
#include "server/stores/redis/redis_testing.h"
#include "tests/integration/cli_fixture.h"
#include "tests/integration/cutting_proxy.h"
#include "tests/integration/running_server_testing.h"

namespace evpose {
namespace {

using client::Client;
using client::LoadCounts;
using client::LoadOptions;
using client::LoadResult;
using ::testing::HasSubstr;

// A rate that every machine reaches.
constexpr double kRateHz = 5000.0;
constexpr int64_t kChunkUs = 10'000;

class BenchLoadTest : public CliTest {
 protected:
  // A short test.
  CliResult RunCommand(const std::string& address, const std::vector<std::string>& more) const {
    std::vector<std::string> arguments = {"bench", "load", "--server", address, "--rate", "5000", "--chunk-ms", "10"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Run(arguments);
  }

  // A test that lasts until `is_enough(counts before the test, counts now)`, however slow the machine is.
  template <typename Enough>
  static absl::StatusOr<LoadResult> RunUntil(const std::string& address, LoadOptions options, const Enough& is_enough) {
    const auto recording = client::LoadRecording::Make(kRateHz, kChunkUs);
    if (!recording.ok()) return recording.status();
    const auto client = Client::Connect(address);
    if (!client.ok()) return client.status();
    const auto config = client::UploadSession(**client, recording->scene(), Encoding::kEvt3);
    if (!config.ok()) return config.status();
    options.addresses = address;
    options.config = *config;
    options.minutes = 30.0;  // more than any machine needs
    std::optional<LoadCounts> before;
    bool is_over = false;
    return client::RunLoad(options, *recording, [&](double ratio, const LoadCounts& counts) {
      if (ratio == 0.0) return true;
      if (!before) before = counts;
      // The sessions end after the test, and their last poses are not counted.
      is_over = is_over || is_enough(*before, counts);
      return !is_over;
    });
  }
};

TEST_F(BenchLoadTest, CountsSessionsAndRefusals) {
  const RunningServer server(WithMetrics({"--max-sessions", "2"}));
  const CliResult result = RunCommand(
      server.address(), {"--sessions", "3", "--minutes", "0.02", "--metrics", server.metrics_address(), "--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json json = result.Json();
  EXPECT_GE(json["created"], 2);
  EXPECT_EQ(json["completed"], json["created"]);
  EXPECT_GE(json["refused"]["TOO_MANY_SESSIONS"], 1);
  EXPECT_TRUE(json["failed"].empty());
  EXPECT_EQ(json["unfinished"], 0);
  EXPECT_EQ(json["lost_poses"], 0);
  EXPECT_EQ(json["reconnections"], 0);
  EXPECT_EQ(json["reconnected_pauses"]["sessions"], 0);
  EXPECT_TRUE(json["reconnected_pauses"]["p99_s"].is_null());
  EXPECT_LE(json["pauses"]["sessions"], json["created"]);
  EXPECT_LE(json["pauses"]["p50_s"], json["pauses"]["p99_s"]);
  EXPECT_LE(json["pauses"]["p99_s"], json["pauses"]["max_s"]);
  EXPECT_GT(json["cpu_s"], 0.0);
  ASSERT_EQ(json["servers"].size(), 1u);
  EXPECT_EQ(json["servers"][0]["metrics"], server.metrics_address());
  EXPECT_GT(json["servers"][0]["cpu_s"], 0.0) << "at least that of the page before";
  EXPECT_GT(json["servers"][0]["resident_mb_before"], 1.0);
  EXPECT_TRUE(json["servers"][0]["store_cpu_s"].is_null()) << "the store is in the server";
  EXPECT_GT(json["servers"][0]["store_mb_after"], 0.0);
  EXPECT_GE(json["servers"][0]["load_ratio_before"], 1.0) << "two of two sessions";
  EXPECT_GE(json["servers"][0]["load_ratio_after"], 1.0) << "the sessions end after the page is read";
  const auto client = Client::Connect(server.address());
  ASSERT_TRUE(client.ok()) << client.status();
  EXPECT_EQ((*client)->ListSessions()->size(), 0u) << "the bench deletes its sessions";
}

TEST_F(BenchLoadTest, ReportsTheUseOfRedis) {
  const server::RedisServer redis;
  const RunningServer server(WithMetrics({"--store", redis.url()}));
  const auto run = [&](const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"--sessions", "1",         "--minutes",
                                          "0.05",       "--metrics", server.metrics_address()};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return RunCommand(server.address(), arguments);
  };
  const CliResult result = run({"--json"});
  ASSERT_EQ(result.status, 0) << result.err;
  const nlohmann::json use = result.Json()["servers"][0];
  EXPECT_GT(use["store_cpu_s"], 0.0);
  EXPECT_GT(use["store_mb_before"], 0.0);
  EXPECT_GT(use["store_mb_after"], 0.0);
  EXPECT_THAT(run({}).out, HasSubstr("\nits store              CPU "));
}

TEST_F(BenchLoadTest, CountsEventsAndPosesOfTheTest) {
  const RunningServer server({});
  LoadOptions options;
  options.sessions = 2;
  options.watchers = 2;
  LoadCounts before, last;
  const auto result = RunUntil(server.address(), options, [&](const LoadCounts& first, const LoadCounts& now) {
    before = first;
    last = now;
    return now.events > first.events && now.poses > first.poses && now.watched_poses > first.watched_poses;
  });
  ASSERT_TRUE(result.ok()) << result.status();
  const LoadCounts& counts = result->counts;
  EXPECT_EQ(counts.created, 2u);
  EXPECT_EQ(counts.completed, 2u);
  EXPECT_TRUE(counts.IsComplete());
  EXPECT_GE(counts.events, last.events - before.events);
  EXPECT_GE(counts.poses, last.poses - before.poses);
  EXPECT_GT(last.poses, before.poses);
  EXPECT_GT(last.watched_poses, before.watched_poses);
  EXPECT_GE(counts.watched_poses, last.watched_poses - before.watched_poses);
}

TEST_F(BenchLoadTest, WaitsForTheWorkOfItsCallers) {
  const RunningServer server({});
  LoadOptions options;
  int num_calls = 0, num_questions = 0;
  options.on_begin = options.on_end = [&] { num_questions = 10 * ++num_calls; };
  options.is_read = [&] { return --num_questions < 0; };
  const auto result = RunUntil(server.address(), options, [&](const LoadCounts&, const LoadCounts&) {
    EXPECT_LT(num_questions, 0) << "the test begins after the work of on_begin";
    return true;
  });
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_EQ(num_calls, 2);
  EXPECT_EQ(num_questions, -1) << "the sessions end after the work of on_end, which is not asked for again";
  EXPECT_TRUE(result->counts.IsComplete());
}

TEST_F(BenchLoadTest, SessionsAreReplaced) {
  const RunningServer server({});
  LoadOptions options;
  options.sessions = 2;
  options.churn_per_minute = 200.0;
  const auto result = RunUntil(server.address(), options, [](const LoadCounts& before, const LoadCounts& now) {
    return now.created >= before.created + 2;
  });
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_GE(result->counts.created, 4u);
  EXPECT_EQ(result->counts.completed, result->counts.created);
  EXPECT_TRUE(result->counts.IsComplete());
}

TEST_F(BenchLoadTest, ReportsThePausesOfSessionsThatReconnect) {
  const std::vector<std::string> arguments = {"--store", "sqlite", "--data-dir", Path("data")};
  auto server = std::make_unique<RunningServer>(arguments);
  CuttingProxy proxy;
  const auto connect = [&] { proxy.SetTarget(std::stoi(server->address().substr(server->address().rfind(':') + 1))); };
  connect();
  LoadOptions options;
  options.sessions = 2;
  bool is_restarted = false;
  uint64_t poses_after = 0;
  const auto result = RunUntil(proxy.address(), options, [&](const LoadCounts& first, const LoadCounts& now) {
    if (!is_restarted && now.poses > first.poses) {
      server->Kill();
      server = std::make_unique<RunningServer>(arguments);
      connect();
      is_restarted = true;
    }
    if (now.reconnections < 2) return false;
    if (poses_after == 0) poses_after = now.poses;
    return now.poses > poses_after;
  });
  ASSERT_TRUE(result.ok()) << result.status();
  const LoadCounts& counts = result->counts;
  EXPECT_TRUE(counts.IsComplete());
  EXPECT_EQ(counts.SortedPausesS(true).size(), 2u);
  EXPECT_EQ(counts.SortedPausesS(true), counts.SortedPausesS(false));
}

TEST_F(BenchLoadTest, GivesUpWhenTheServersAreAway) {
  const auto recording = client::LoadRecording::Make(kRateHz, kChunkUs);
  ASSERT_TRUE(recording.ok()) << recording.status();
  const ClosedPort closed;
  LoadOptions options;
  options.addresses = closed.address();
  options.sessions = 2;
  options.max_outage = absl::Milliseconds(1);
  const auto result = client::RunLoad(options, *recording, [](double, const LoadCounts&) { return true; });
  EXPECT_EQ(result.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(result.status().message(),
              HasSubstr(closed.address() + ": 2 of 2 sessions were neither created nor refused"));
}

TEST_F(BenchLoadTest, PrintsATable) {
  const RunningServer server({});
  const CliResult result = RunCommand(server.address(), {"--sessions", "1", "--minutes", "0.01"});
  ASSERT_EQ(result.status, 0) << result.err;
  for (const char* const row :
       {"sessions created       1 (1 completed)\n", "\nposes lost             0\n", "\nlatency                p50 ",
        "\nlongest pauses         ", "\nafter reconnection     0 sessions\n", "\nCPU of this process "}) {
    EXPECT_THAT(result.out, HasSubstr(row));
  }
}

TEST_F(BenchLoadTest, ReportsServersThatTakeNoSession) {
  // Less than any session needs, so that waiting does not help.
  const RunningServer server({"--max-session-memory", "1000000"});
  const CliResult full = RunCommand(server.address(), {"--sessions", "1", "--minutes", "0.01"});
  EXPECT_EQ(full.status, 1);
  EXPECT_THAT(full.err, HasSubstr("no session was created (SESSION_MEMORY 1)"));
  const ClosedPort closed;
  const CliResult unreachable = RunCommand(closed.address(), {"--connect-timeout", "0.1"});
  EXPECT_EQ(unreachable.status, 1);
  EXPECT_THAT(unreachable.err, HasSubstr(closed.address()));
  const CliResult blind = RunCommand(server.address(), {"--metrics", server.address()});
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
