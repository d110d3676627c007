// SPDX-License-Identifier: Apache-2.0

// Tests that sessions survive a killed server: SIGKILL at random numbers of poses in the middle of a stream; every pose
// is delivered once, with the bits of the undisturbed run. EVPOSE_KILLS sets the number of kills
// (tests/bench/survival.sh: 50).
#include <gmock/gmock.h>
#include <sqlite3.h>

#include <csignal>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/http/http_client_testing.h"
#include "server/stores/postgres/postgres_testing.h"
#include "server/stores/redis/redis_keys.h"
#include "server/stores/redis/redis_testing.h"
#include "tests/integration/survival_testing.h"

namespace evpose {
namespace {

using server::Program;

// Returns the session and the bytes of the largest pose segment of all sessions.
std::pair<std::string, std::string> LargestPoses(const std::string& file) {
  sqlite3* database = nullptr;
  sqlite3_stmt* statement = nullptr;
  EXPECT_EQ(sqlite3_open_v2(file.c_str(), &database, SQLITE_OPEN_READONLY, nullptr), SQLITE_OK);
  const char* query = "SELECT session, bytes FROM poses ORDER BY length(bytes) DESC LIMIT 1";
  EXPECT_EQ(sqlite3_prepare_v2(database, query, -1, &statement, nullptr), SQLITE_OK);
  EXPECT_EQ(sqlite3_step(statement), SQLITE_ROW);
  const auto text = [statement](int column) {
    const auto* begin = static_cast<const char*>(sqlite3_column_blob(statement, column));
    return std::string(begin, static_cast<size_t>(sqlite3_column_bytes(statement, column)));
  };
  const std::pair<std::string, std::string> poses(text(0), text(1));
  sqlite3_finalize(statement);
  sqlite3_close(database);
  return poses;
}

class SurvivalTest : public SurvivalFixture {
 protected:
  // Streams until the server is killed at this number of poses, or later if `awaits_durable` and nothing is durable
  // yet, with chunks and poses in transit; then returns true. Returns false if the stream ended first.
  static bool StreamUntilKilled(RunningServer& server, size_t kill_at, bool awaits_durable, RawClient& client) {
    bool is_killed = false;
    client.OnPose([&](size_t poses) {  // poses in transit may follow
      if (is_killed || poses < kill_at || (awaits_durable && client.durable_seq() == 0)) return;
      server.Kill();
      is_killed = true;
    });
    client.MayBreak(true);
    const bool is_finished = client.Stream(server, SIZE_MAX);
    client.MayBreak(false);
    client.OnPose(nullptr);
    EXPECT_TRUE(is_finished || is_killed);
    return is_killed;
  }

  // Kills servers started with `arguments(run)`, in each run up to three times.
  void KillAtRandom(const std::function<std::vector<std::string>(int run)>& arguments) {
    const std::vector<std::string> expected = Undisturbed();
    ASSERT_GT(expected.size(), 100u);
    std::mt19937 random(5);
    const int kills_wanted = NumberFrom("EVPOSE_KILLS", 4);
    int kills = 0;
    int kills_after_a_checkpoint = 0;
    for (int run = 0; kills < kills_wanted; ++run) {
      auto server = std::make_unique<RunningServer>(arguments(run));
      RawClient client = MakeClient(*server);
      for (int i = 0; i < 3 && kills < kills_wanted; ++i, ++kills) {
        const size_t kill_at = client.poses().size() + 1 + random() % (expected.size() / 4);
        // On a fast machine a few hundred poses may not need a checkpoint; a thousand poses do on every machine.
        if (!StreamUntilKilled(*server, kill_at, i == 2, client)) break;
        server = std::make_unique<RunningServer>(arguments(run));
        kills_after_a_checkpoint += client.durable_seq() > 0;
      }
      ASSERT_TRUE(client.Stream(*server, SIZE_MAX));
      ASSERT_EQ(client.poses().size(), expected.size()) << "run " << run;
      EXPECT_TRUE(client.poses() == expected) << "run " << run;
      server->program().Signal(SIGTERM);
      EXPECT_EQ(server->program().Wait(), 0);
    }
    EXPECT_GT(kills_after_a_checkpoint, 0) << "at least one kill must occur after a checkpoint";
  }

  static std::vector<std::string> OnRedis(const server::RedisServer& redis) {
    return {"--store", redis.url(), "--log-level", "warning"};
  }
};

TEST_F(SurvivalTest, KilledServersLoseNothingWithSqlite) {
  KillAtRandom([this](int run) { return Sqlite(absl::StrCat("data", run)); });
}

TEST_F(SurvivalTest, KilledServersLoseNothingWithRedis) {
  const server::RedisServer redis;
  KillAtRandom([&redis](int) { return OnRedis(redis); });
}

TEST_F(SurvivalTest, KilledServersLoseNothingWithPostgresql) {
  const server::PostgresServer postgres;
  KillAtRandom([&postgres](int) {
    return std::vector<std::string>{"--store", postgres.url(), "--log-level", "warning"};
  });
}

TEST_F(SurvivalTest, AKilledPrimaryOfPostgresqlLosesNothing) {
  const std::vector<std::string> expected = Undisturbed();
  server::PostgresServer primary;
  server::PostgresServer standby(server::PostgresServer::StandbyOf{primary});
  primary.AwaitSynchronous("standby");
  RunningServer server({"--store", primary.url() + "," + standby.host(), "--log-level", "warning"});
  RawClient client = MakeClient(server);
  bool is_killed = false;
  client.OnPose([&](size_t poses) {
    if (is_killed || poses < expected.size() / 3) return;
    is_killed = true;
    primary.Kill();
    EXPECT_EQ(standby.Run("SELECT pg_promote()"), "t");
  });
  EXPECT_TRUE(client.Stream(server, SIZE_MAX));
  EXPECT_TRUE(is_killed);
  EXPECT_TRUE(client.poses() == expected);
}

TEST_F(SurvivalTest, ASessionMovesBetweenServersOnOneRedis) {
  const std::vector<std::string> expected = Undisturbed();
  const server::RedisServer redis;
  RunningServer one(OnRedis(redis));
  RunningServer two(OnRedis(redis));
  RawClient client = MakeClient(one);
  constexpr size_t kMoves = 10;
  for (size_t i = 1; i <= kMoves; ++i) {
    EXPECT_FALSE(client.Stream(i % 2 == 0 ? one : two, i * expected.size() / (kMoves + 1)));
  }
  EXPECT_TRUE(client.Stream(one, SIZE_MAX));
  EXPECT_TRUE(client.poses() == expected);
}

// A session goes to a new group, and then the old one is lost.
TEST_F(SurvivalTest, AGroupOfRedisIsAddedAndAnotherLost) {
  const std::vector<std::string> expected = Undisturbed();
  server::RedisServer first;
  const server::RedisServer second;
  const auto groups = [this](const std::string& name, const std::string& text) {
    WriteText(name, text);
    return std::vector<std::string>{"--store", "redis-groups:" + Path(name), "--log-level", "warning"};
  };
  // The store has one group at first.
  { RunningServer server(groups("one", "first " + first.url())); }
  const std::vector<std::string> both = groups("two", "first " + first.url() + "\nsecond " + second.url());
  RunningServer server(both);
  const auto client_in = [&](bool moves) {
    while (true) {
      RawClient client = MakeClient(server);
      if ((server::RedisBucketOf(client.session()) >= server::kRedisBuckets / 2) == moves) return client;
    }
  };
  RawClient client = client_in(true);
  client.OnPose([&](size_t poses) {
    if (poses == expected.size() / 3) {
      std::vector<std::string> divide = both;
      divide.emplace_back("--divide-store");
      Program program(divide);
      EXPECT_EQ(program.Wait(), 0) << program.Stderr();
    }
    if (poses == 2 * expected.size() / 3) first.Kill();
  });
  EXPECT_TRUE(client.Stream(server, SIZE_MAX));
  EXPECT_TRUE(client.poses() == expected);
  first.Start();
}

TEST_F(SurvivalTest, WhileRedisIsUnreachableTheServerIsNotReadyAndNothingIsLost) {
  const std::vector<std::string> expected = Undisturbed();
  server::RedisServer redis;
  RunningServer server(WithMetrics(OnRedis(redis)));
  const int port = server::PortOf(server.metrics_address());
  RawClient client = MakeClient(server);
  bool was_away_at_the_end = false;
  client.OnPose([&](size_t poses) {
    if (poses == expected.size() / 3) {
      redis.Kill();
      server::WaitUntilReadyIs(port, 503);
    }
    if (poses == expected.size()) {  // the summary is sent after the store has responded
      was_away_at_the_end = server::Ask(port, "/readyz").status == 503 && server::Ask(port, "/healthz").status == 200;
      redis.Start();
    }
  });
  EXPECT_TRUE(client.Stream(server, SIZE_MAX));
  EXPECT_TRUE(was_away_at_the_end);
  EXPECT_TRUE(client.poses() == expected);
  server::WaitUntilReadyIs(port, 200);
}

TEST_F(SurvivalTest, AServerThatShutsDownKeepsProcessedData) {
  const std::vector<std::string> expected = Undisturbed();
  const std::vector<std::string> arguments = Sqlite("data");
  auto server = std::make_unique<RunningServer>(arguments);
  RawClient client = MakeClient(*server);
  EXPECT_FALSE(client.Stream(*server, expected.size() / 2));
  server->program().Signal(SIGTERM);
  EXPECT_EQ(server->program().Wait(), 0);
  server = std::make_unique<RunningServer>(arguments);
  EXPECT_TRUE(client.Stream(*server, SIZE_MAX));
  EXPECT_TRUE(client.poses() == expected);
}

TEST_F(SurvivalTest, ASecondSignalLosesNothing) {
  const std::vector<std::string> expected = Undisturbed();
  const std::vector<std::string> arguments = Sqlite("data");
  auto server = std::make_unique<RunningServer>(arguments);
  RawClient client = MakeClient(*server);
  client.OnPose([&](size_t poses) {
    if (poses == expected.size() / 2) server->program().Signal(SIGTERM);
  });
  int status = 0;
  client.OnGoAway([&] {  // the server waits for this stream, which does not end
    server->program().Signal(SIGTERM);
    status = server->program().Wait();
  });
  client.MayBreak(true);
  EXPECT_FALSE(client.Stream(*server, SIZE_MAX));
  EXPECT_EQ(status, -SIGTERM) << "the second signal ends the server immediately";
  EXPECT_LT(client.poses().size(), expected.size());
  client.MayBreak(false);
  client.OnPose(nullptr);
  client.OnGoAway(nullptr);
  server = std::make_unique<RunningServer>(arguments);
  EXPECT_TRUE(client.Stream(*server, SIZE_MAX));
  EXPECT_TRUE(client.poses() == expected);
}

TEST_F(SurvivalTest, AReplayThatFilledTheStoreContinuesWhenSpaceIsAvailable) {
  ASSERT_EQ(Run(ReplayArguments("expected.csv")).status, 0);
  const auto replay = [this](RunningServer& server) {
    return Run(ReplayArguments("poses.csv", {"--server", server.address(), "--resume", Path("state")}));
  };
  std::vector<std::string> small = Sqlite("data");
  small.insert(small.end(), {"--store-max-bytes", "1048576"});
  RunningServer full(small);
  // A model of 0.5 MB, most of it comments: the poses alone do not fill the smallest store that is permitted.
  std::string large = ReadText("cube/model.obj");
  for (int line = 0; line < 6000; ++line) large += "#" + std::string(78, ' ') + "\n";
  WriteText("large.obj", large);
  ASSERT_EQ(Run({"models", "upload", Path("large.obj"), "--server", full.address()}).status, 0);
  const CliResult stopped = replay(full);
  EXPECT_EQ(stopped.status, 1);
  EXPECT_THAT(stopped.err, testing::HasSubstr("make room"));
  full.program().Signal(SIGTERM);
  EXPECT_EQ(full.program().Wait(), 0);
  RunningServer roomy(Sqlite("data"));
  const CliResult finished = replay(roomy);
  EXPECT_EQ(finished.status, 0) << finished.err;
  EXPECT_TRUE(ReadText("poses.csv") == ReadText("expected.csv"));
}

TEST_F(SurvivalTest, ATamperedStoreIsNamedAtStart) {
  auto server = std::make_unique<RunningServer>(Sqlite("data"));
  RawClient client = MakeClient(*server);
  RawClient other = MakeClient(*server);
  EXPECT_TRUE(client.Stream(*server, SIZE_MAX));
  EXPECT_TRUE(other.Stream(*server, SIZE_MAX));
  server->program().Signal(SIGTERM);
  EXPECT_EQ(server->program().Wait(), 0);
  const auto [session, poses] = LargestPoses(Path("data/evpose.db"));
  std::string file = ReadText("data/evpose.db");
  // Both sessions have the same poses, apart from their latencies: the bytes to change must be found at one place only.
  constexpr size_t kStretchBytes = 100;
  size_t place = std::string::npos;
  for (size_t begin = 0; begin + kStretchBytes < poses.size() && place == std::string::npos; begin += kStretchBytes) {
    const std::string stretch = poses.substr(begin, kStretchBytes);
    if (file.find(stretch) == file.rfind(stretch)) place = file.find(stretch);
  }
  ASSERT_NE(place, std::string::npos);
  file[place + 20] = static_cast<char>(file[place + 20] ^ 0x55);
  WriteText("data/evpose.db", file);
  Program again({"--store", "sqlite", "--data-dir", Path("data"), "--listen", "127.0.0.1:0"});
  const std::string address = again.Announced("listening on ");
  EXPECT_THAT(again.Stderr(), testing::ContainsRegex("error store_damage [^\n]*" + session));
  const std::string intact = session == client.session() ? other.session() : client.session();
  EXPECT_THAT(again.Stderr(), testing::HasSubstr("sessions_found sessions=1"));
  const auto sessions = v1::SessionService::NewStub(grpc::CreateChannel(address, grpc::InsecureChannelCredentials()));
  grpc::ClientContext context;
  v1::GetSessionRequest request;
  request.set_name(intact);
  v1::Session found;
  EXPECT_TRUE(sessions->GetSession(&context, request, &found).ok());
  EXPECT_THAT(again.Stderr(), testing::ContainsRegex("session_resumed session=" + intact + " "));
}

TEST_F(SurvivalTest, AStoreThatCannotBeUsedIsOneLine) {
  RunningServer server(Sqlite("data"));
  Program second({"--store", "sqlite", "--data-dir", Path("data"), "--listen", "127.0.0.1:0"});
  EXPECT_EQ(second.Wait(), 1);
  EXPECT_THAT(second.Stderr(), testing::MatchesRegex("evpose-server: [^\n]*data[^\n]*another server[^\n]*\n"));
  Program missing({"--store", "sqlite", "--data-dir", Path("no/such/place"), "--listen", "127.0.0.1:0"});
  EXPECT_EQ(missing.Wait(), 1);
  EXPECT_THAT(missing.Stderr(), testing::MatchesRegex("evpose-server: [^\n]*no/such/place[^\n]*\n"));
  Program unknown({"--store", "postgres", "--listen", "127.0.0.1:0"});
  EXPECT_EQ(unknown.Wait(), 2) << "wrong usage";
  EXPECT_THAT(unknown.Stderr(), testing::MatchesRegex("evpose-server: [^\n]*postgres[^\n]*\n"));
}

}  // namespace
}  // namespace evpose
