// SPDX-License-Identifier: Apache-2.0

// Tests evpose-server as a process: output, exit statuses and signals.
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_split.h"
#include "core/base/closed_port_testing.h"
#include "core/base/environment_testing.h"
#include "evpose/v1/session_service.grpc.pb.h"
#include "server/http/http_client_testing.h"
#include "server/program/program_testing.h"
#include "server/stores/postgres/postgres_testing.h"
#include "server/stores/redis/redis_testing.h"
#include "server/telemetry/prometheus_testing.h"

namespace evpose::server {
namespace {

TEST(ProgramTest, PrintsItsAddressAndEndsAtASignal) {
  for (const int number : {SIGTERM, SIGINT}) {
    const std::string port_file = TemporaryPath("port");
    Program program({"--listen", "127.0.0.1:0", "--port-file", port_file});
    const int port = PortOf(program.Announced("listening on 127.0.0.1:"));
    ASSERT_GT(port, 0);
    EXPECT_EQ(Contents(port_file), std::to_string(port) + "\n");
    unlink(port_file.c_str());

    Program second({"--listen", "127.0.0.1:" + std::to_string(port)});
    EXPECT_EQ(second.Wait(), 1);
    const std::string error = second.Stderr();
    EXPECT_THAT(
        error,
        testing::MatchesRegex(
            "evpose-server: cannot listen on 127.0.0.1:[0-9]+: .* in use; another program has this port[^\n]*\n"));

    program.Signal(number);
    EXPECT_EQ(program.Wait(), 0);
  }
}

// Without it, a variable of the shell that is not set would start a server that requires no token.
TEST(ProgramTest, AnEmptyValueIsWrongUsage) {
  for (const auto& [option, expected] : {std::pair("--new-token", "--new-token: the tenant's name is empty; "),
                                         {"--token-file", "--token-file: the name is empty; "},
                                         {"--tls-client-ca", "--tls-client-ca: the name is empty; "}}) {
    Program program({option, ""});
    EXPECT_EQ(program.Wait(), 2);
    EXPECT_THAT(program.Stderr(), testing::HasSubstr(expected));
  }
}

TEST(ProgramTest, ReportsWrongUsage) {
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases = {
      {{"--no-such-option"}, "--no-such-option"},
      {{"--listen", "nowhere"}, "has no port"},
      {{"--listen", "0.0.0.0:0"}, "--insecure"},
      {{"--workers", "-1"}, "--workers: is -1;"},
      {{"--slow-threads", "0"}, "--slow-threads: is 0;"},
      {{"--model-cpu-seconds", "0"}, "--model-cpu-seconds: is 0;"},
      {{"--model-memory", "1000"}, "--model-memory: is 1000;"},
      {{"--max-uploads", "0"}, "--max-uploads: is 0;"},
      {{"--upload-timeout", "0"}, "--upload-timeout: must be positive"},
      {{"--upload-timeout", "inf"}, "--upload-timeout: is inf; at most a year"},
      {{"--tls-cert", "c"}, "--tls-cert needs --tls-key"},
      {{"--listen", "0.0.0.0:0", "--token-file", "t"}, "nothing is encrypted"},
      {{"--listen", "0.0.0.0:0", "--tls-cert", "c", "--tls-key", "k"}, "anybody may use the server"},
      {{"--new-token", "two words"}, "is not a tenant's name"},
      {{"--operator"}, "--new-token"},
      {{"--max-sessions", "0"}, "--max-sessions: is 0;"},
      {{"--max-session-memory", "1000"}, "--max-session-memory: is 1000;"},
      {{"--max-session-cpu", "-1"}, "--max-session-cpu: is -1; give 0 (no limit), or 0.01 to 1024"},
      {{"--tenant-max-cpu", "nan"}, "--tenant-max-cpu: is nan; give 0 (no limit), or 0.01 to 1024"},
      {{"--shutdown-timeout", "-1"}, "--shutdown-timeout: must not be negative"},
      {{"--shutdown-notice", "-0.1"}, "--shutdown-notice: must not be negative"},
      {{"--shutdown-notice", "nan"}, "--shutdown-notice: is inf; at most a year, 31536000 s"},
      {{"--shutdown-notice", "1e300"}, "--shutdown-notice: is inf; at most a year"},
      {{"--shutdown-timeout", "nan"}, "--shutdown-timeout: is inf; at most a year"},
      {{"--shutdown-timeout", "31536001"}, "--shutdown-timeout: is 8760h1s; at most a year"},
      {{"--session-expiry", "nan"}, "--session-expiry: is inf; at most a year"},
      {{"--session-expiry", "inf"}, "--session-expiry: is inf; at most a year"},
      {{"--session-expiry", "0"}, "--session-expiry: must be positive"},
      {{"--attach-timeout", "nan"}, "--attach-timeout: is inf; at most a year"},
      {{"--attach-timeout", "0"}, "--attach-timeout: must be positive"},
      {{"--tls-client-crl", "c"}, "--tls-client-crl needs --tls-client-ca"},
      {{"--listener-timeout", "0.5"}, "--listener-timeout: is 500ms; give at least 1s"},
      {{"--stream-idle-timeout", "-1"}, "--stream-idle-timeout: must not be negative"},
      {{"--max-transport-bytes", "8"}, "--max-transport-bytes: is 8; give at least 67108864"},
      {{"--credit-bytes", "8"}, "--credit-bytes: is 8; give at least "},
      {{"--tenant-max-model-bytes", "8"}, "--tenant-max-model-bytes: is 8; give 0 (no own limit) or at least "},
      {{"--store", "foo"}, "--store: there is no store foo: give memory, sqlite, redis://HOST:PORT, redis+sentinel:"},
      {{"--store", "redis://"}, "--store: the store's address has no host"},
      {{"--store-max-bytes", "1000"}, "--store-max-bytes: is 1000; give at least 1048576"},
      {{"--store", "redis://localhost", "--store-max-bytes", "2000000"}, "set maxmemory in Redis instead"},
      {{"--store-password-file", "p"}, "--store-password-file: is for --store redis://HOST:PORT, redis+sentinel:"},
      {{"--store", "redis://:one@localhost", "--store-password-file", "p"}, "has a password already"},
      {{"--store", "postgresql://:one@localhost/db", "--store-password-file", "p"}, "has a password already"},
      {{"--event-images", "perhaps"}, "--event-images"},
      {{"--log-level", "loud"}, "--log-level"},
      {{"--log-format", "xml"}, "--log-format"},
      {{"--metrics-listen", "9464"}, "--metrics-listen: address \"9464\" has no port; give HOST:PORT"},
      {{"--metrics-listen", "localhost:port"},
       "--metrics-listen: address \"localhost:port\" has a port that is no number"},
      {{"--listen", "127.0.0.1:9464", "--metrics-listen", "127.0.0.1:9464"},
       "--metrics-listen: is the address of --listen: give another port"},
  };
  for (const auto& [arguments, expected] : cases) {
    Program program(arguments);
    EXPECT_EQ(program.Wait(), 2) << expected;
    const std::string message = program.Stderr();
    EXPECT_THAT(message, testing::HasSubstr(expected));
    EXPECT_THAT(message, testing::MatchesRegex("evpose-server: [^\n]*\n")) << "more than one line";
  }
}

TEST(ProgramTest, ABadStartIsOneLineWithCauseAndRemedy) {
  const std::string prose = TemporaryPath("prose");
  std::ofstream(prose) << "neither key nor certificate, nor token\n";
  const std::string empty = TemporaryPath("empty");
  std::ofstream(empty) << "";
  const ClosedPort closed;
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases = {
      {{"--tls-cert", "/no/such.crt", "--tls-key", "/no/such.key"}, "/no/such.crt[^\n]*"},
      {{"--tls-cert", prose, "--tls-key", prose}, prose + "[^\n]*certificate[^\n]*"},
      {{"--token-file", "/no/such/tokens"}, "/no/such/tokens[^\n]*"},
      {{"--token-file", prose}, prose + ":1: [^\n]*--new-token[^\n]*"},
      {{"--store", "redis://localhost", "--store-password-file", "/no/such/password"}, "/no/such/password[^\n]*"},
      {{"--store", "redis://localhost", "--store-password-file", "/dev/null"}, "/dev/null[^\n]*not a file[^\n]*"},
      {{"--store", "redis://localhost", "--store-password-file", empty}, empty + "[^\n]*there is no password in it"},
      {{"--store", "redis://" + closed.address()},
       "[^\n]*" + closed.address() + "/0 does not respond: [^\n]*start Redis there[^\n]*"},
      {{"--store", "redis-groups:/no/such/groups"}, "/no/such/groups[^\n]*"},
      {{"--store", "redis-groups:/no/such/groups", "--divide-store"}, "--divide-store: /no/such/groups[^\n]*"},
      {{"--store", "redis-groups:" + empty}, empty + ": there is no group: give each a line NAME ADDRESS"},
      {{"--store", "sqlite", "--data-dir", "/dev/null"}, "data directory /dev/null: [^\n]*another --data-dir"},
      {{"--store", "sqlite", "--data-dir", "/proc/evpose"}, "data directory /proc/evpose: [^\n]*another --data-dir"},
      {{"--store", "sqlite", "--data-dir", "/sys/evpose"},
       "data directory /sys/evpose: [^\n]*let the server's user write there, or choose another --data-dir"},
      {{"--port-file", "/no/such/directory/port"}, "/no/such/directory/port[^\n]*"},
  };
  for (const auto& [arguments, expected] : cases) {
    std::vector<std::string> all = {"--listen", "127.0.0.1:0", "--log-level", "warning"};
    all.insert(all.end(), arguments.begin(), arguments.end());
    Program program(all);
    EXPECT_EQ(program.Wait(), 1) << expected;
    EXPECT_THAT(program.Stderr(), testing::MatchesRegex("evpose-server: " + expected + "\n"));
  }
  unlink(prose.c_str());
  unlink(empty.c_str());
}

TEST(ProgramTest, ThreadsThatCannotBeCreatedAreOneLine) {
  constexpr rlim_t kLimit = rlim_t{1} << 30;
  rlim_t own_pages = 0;
  std::ifstream("/proc/self/statm") >> own_pages;
  if (own_pages * sysconf(_SC_PAGESIZE) > kLimit) GTEST_SKIP() << "sanitizers reserve terabytes of address space";
  rlimit before;
  ASSERT_EQ(getrlimit(RLIMIT_AS, &before), 0);
  rlimit small = before;
  small.rlim_cur = kLimit;
  ASSERT_EQ(setrlimit(RLIMIT_AS, &small), 0);  // inherited by the program
  Program program({"--listen", "127.0.0.1:0", "--workers", "1024"});
  ASSERT_EQ(setrlimit(RLIMIT_AS, &before), 0);
  EXPECT_EQ(program.Wait(), 1);
  EXPECT_THAT(program.Stderr(),
              testing::MatchesRegex("evpose-server: only [0-9]+ of 1064 threads [^\n]*fewer --workers[^\n]*\n"));
}

TEST(ProgramTest, ImagesOfEventsCanBeSwitchedOff) {
  const auto watch_unknown = [](std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--listen", "127.0.0.1:0", "--store", "memory"});
    Program program(arguments);
    const std::string address = program.Announced("listening on ");
    const auto sessions = v1::SessionService::NewStub(grpc::CreateChannel(address, grpc::InsecureChannelCredentials()));
    grpc::ClientContext context;
    v1::WatchEventsRequest request;
    request.set_session("sessions/unknown");
    return sessions->WatchEvents(&context, request)->Finish();
  };
  EXPECT_EQ(watch_unknown({}).error_code(), grpc::StatusCode::NOT_FOUND);
  const grpc::Status off = watch_unknown({"--event-images=false"});
  EXPECT_EQ(off.error_code(), grpc::StatusCode::FAILED_PRECONDITION);
  EXPECT_THAT(off.error_message(), testing::HasSubstr("started with --event-images=false"));
}

TEST(ProgramTest, TenantsHaveHalfOfTheServerByDefault) {
  Program maker({"--new-token", "lab"});
  maker.ReadLine();
  EXPECT_EQ(maker.Wait(), 0);
  const std::string message = maker.Stderr();
  ASSERT_NE(message.find("lab "), std::string::npos) << message;
  const std::string path = TemporaryPath("tokens");
  std::ofstream(path) << message.substr(message.find("lab "));
  Program program({"--listen", "127.0.0.1:0", "--token-file", path, "--max-sessions", "12", "--tenant-max-watchers",
                   "3", "--tenant-max-streams", "0", "--max-session-memory", "1000000000", "--tenant-max-cpu", "1.5"});
  program.Announced("listening on 127.0.0.1:");
  EXPECT_THAT(
      program.Stderr(),
      testing::HasSubstr(" tenant_limits max_sessions=6 max_session_memory=500000000 "
                         "max_model_bytes=268435456 max_uploads=32 max_streams=0 max_watchers=3 max_bytes_per_s=0 "
                         "max_cpu=1.5 max_health_per_s=1000\n"));
  unlink(path.c_str());
}

TEST(ProgramTest, ARedisThatCannotBeUsedIsOneLineWithoutItsPassword) {
  const RedisServer redis({"--requirepass", "right-secret"});
  const ClosedPort closed;
  // Malformed addresses, and servers that do not respond or reject the password.
  const std::vector<std::pair<std::string, std::string>> malformed = {
      {"redis://:wrong-secret@127.0.0.1:none", "port[^\n]*give redis://"},
      {"redis://user:wrong-secret@127.0.0.1:1/x", "database[^\n]*give redis://"},
      {"rediss://user:wrong-secret@127.0.0.1", "no TLS; use redis://"},
      {"http://user:wrong-secret@127.0.0.1", "scheme[^\n]*give redis://"},
      {"redis+sentinel://user:wrong-secret@127.0.0.1:1", "no name of the master[^\n]*or redis\\+sentinel://"},
      {"redis:/user:wrong-secret@127.0.0.1", "there is no store of this name: give memory, sqlite, redis://"},
  };
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"redis+unix:///no/such/socket", "/no/such/socket does not respond: No such file[^\n]*start Redis there"},
      {"redis+unix://user:wrong-secret@/no/such/socket", "/no/such/socket does not respond: [^\n]*start Redis there"},
      {"redis+sentinel://user:wrong-secret@" + closed.address() + "/cameras",
       "no Sentinel names the master cameras: " + closed.address() + " does not respond: [^\n]*start the Sentinels"},
      {redis.url(), "NOAUTH[^\n]*check the user and password of --store"},
      {redis.url(":wrong-secret@"), "WRONGPASS[^\n]*check the user and password of --store"},
  };
  const auto expect = [](const std::string& store, int status, const std::string& expected) {
    Program program({"--listen", "127.0.0.1:0", "--store", store});
    EXPECT_EQ(program.Wait(), status) << store;
    const std::string message = program.Stderr();
    EXPECT_THAT(message, testing::MatchesRegex("evpose-server: [^\n]*" + expected + "[^\n]*\n")) << store;
    EXPECT_THAT(message, testing::Not(testing::HasSubstr("secret"))) << store;
  };
  for (const auto& [store, expected] : malformed) expect(store, 2, expected);
  for (const auto& [store, expected] : cases) expect(store, 1, expected);
  Program program({"--listen", "127.0.0.1:0", "--store", redis.url(":right-secret@")});
  program.Announced("listening on 127.0.0.1:");
  EXPECT_THAT(program.Stderr(), testing::Not(testing::HasSubstr("secret")));
}

TEST(ProgramTest, APostgresqlThatCannotBeUsedIsOneLineWithoutItsPassword) {
  const PostgresServer postgres;
  const std::string password = "right:secret@/% \xc3\xa9";  // characters that are reserved in an address
  postgres.Run("CREATE ROLE keyed LOGIN SUPERUSER PASSWORD '" + password + "'");
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"postgresql://user:wrong-secret@127.0.0.1", "has no database: give postgresql://"},
      {"postgresql://user:wrong-secret@/db?host=/no/such",
       "/no/such/db does not respond: [^\n]*start PostgreSQL there"},
      {postgres.url("keyed:wrong-secret"),
       "password authentication failed[^\n]*check the user and password of --store"},
      {postgres.url("evpose", "nowhere"), "\"nowhere\" does not exist: create it"},
  };
  for (const auto& [store, expected] : cases) {
    Program program({"--listen", "127.0.0.1:0", "--store", store});
    EXPECT_EQ(program.Wait(), absl::StrContains(expected, "give postgresql://") ? 2 : 1) << store;
    const std::string message = program.Stderr();
    EXPECT_THAT(message, testing::MatchesRegex("evpose-server: [^\n]*" + expected + "[^\n]*\n")) << store;
    EXPECT_THAT(message, testing::Not(testing::HasSubstr("secret"))) << store;
  }
  const std::string path = TemporaryPath("password");
  std::ofstream(path) << password << "\n";
  Program program({"--listen", "127.0.0.1:0", "--store", postgres.url("keyed"), "--store-password-file", path});
  program.Announced("listening on 127.0.0.1:");
  EXPECT_THAT(program.Stderr(), testing::HasSubstr(" store=postgresql:///"));
  EXPECT_THAT(program.Stderr(), testing::Not(testing::HasSubstr("secret")));
  unlink(path.c_str());
}

TEST(ProgramTest, APasswordNeedNotBeInTheArguments) {
  const std::string password = "right:secret@/% \xc3\xa9";  // characters that are reserved in an address
  const RedisServer redis({"--requirepass", password});
  const std::string path = TemporaryPath("password");
  std::ofstream(path) << password << "\n";
  const auto expect_ready = [](Program& program) {
    program.Announced("listening on 127.0.0.1:");
    const std::string message = program.Stderr();
    EXPECT_THAT(message, testing::HasSubstr(" store=redis+unix:///"));
    EXPECT_THAT(message, testing::Not(testing::HasSubstr("secret")));
    program.Signal(SIGTERM);
    EXPECT_EQ(program.Wait(), 0);
  };
  for (const std::string user : {"", "default:@"}) {
    Program program({"--listen", "127.0.0.1:0", "--store", redis.url(user), "--store-password-file", path});
    expect_ready(program);
  }
  unlink(path.c_str());
  const ScopedEnvironmentVariable store("EVPOSE_STORE", redis.url(":right%3Asecret%40%2F%25%20%C3%A9@"));
  Program program({"--listen", "127.0.0.1:0"});
  expect_ready(program);
}

TEST(ProgramTest, TheCommandLineHasPrecedenceOverTheEnvironment) {
  const ScopedEnvironmentVariable store("EVPOSE_STORE", "foo");
  {
    Program program({"--listen", "127.0.0.1:0"});
    EXPECT_EQ(program.Wait(), 2);
    EXPECT_THAT(program.Stderr(), testing::HasSubstr("there is no store foo"));
  }
  Program program({"--listen", "127.0.0.1:0", "--store", "memory"});
  program.Announced("listening on 127.0.0.1:");
}

TEST(ProgramTest, AGeneratedTokenIsAccepted) {
  Program maker({"--new-token", "lab", "--operator"});
  const std::string token = maker.ReadLine();
  EXPECT_EQ(maker.Wait(), 0);
  EXPECT_TRUE(absl::StartsWith(token, "evpose_")) << token;
  const std::string message = maker.Stderr();
  const size_t line = message.find("lab ");
  ASSERT_NE(line, std::string::npos) << message;
  const std::string path = TemporaryPath("tokens");
  std::ofstream(path) << message.substr(line);
  Program program({"--listen", "127.0.0.1:0", "--token-file", path});
  program.Announced("listening on 127.0.0.1:");
  program.Signal(SIGTERM);
  EXPECT_EQ(program.Wait(), 0);
  EXPECT_THAT(program.Stderr(), testing::HasSubstr(" tokens=1\n"));
  EXPECT_THAT(program.Stderr(), testing::Not(testing::HasSubstr(token)));
  unlink(path.c_str());
}

TEST(ProgramTest, ServesThePagesForOperators) {
  Program program({"--listen", "127.0.0.1:0", "--metrics-listen", "127.0.0.1:0"});
  program.Announced("listening on 127.0.0.1:");
  const int port = PortOf(program.Announced("metrics on 127.0.0.1:"));
  ASSERT_GT(port, 0);
  EXPECT_THAT(program.Stderr(), testing::HasSubstr("http://127.0.0.1:" + std::to_string(port) + "/metrics"));
  EXPECT_EQ(Ask(port, "/healthz").status, 200);
  EXPECT_EQ(Ask(port, "/readyz").status, 200);
  const ParsedMetrics metrics = ParseMetrics(Ask(port, "/metrics").body);
  EXPECT_EQ(metrics.At("evpose_ready"), 1.0);
  EXPECT_EQ(metrics.At("evpose_max_sessions"), 64.0);
  EXPECT_EQ(metrics.types.at("evpose_build_info"), "gauge");

  Program second({"--listen", "127.0.0.1:0", "--metrics-listen", "127.0.0.1:" + std::to_string(port)});
  EXPECT_EQ(second.Wait(), 1);
  EXPECT_THAT(
      second.Stderr(),
      testing::MatchesRegex("evpose-server: --metrics-listen: cannot listen on 127.0.0.1:[0-9]+: .* in use; another "
                            "program has this port: give another, or 0 for a free one\n"));
  program.Signal(SIGTERM);
  EXPECT_EQ(program.Wait(), 0);
}

TEST(ProgramTest, ReportsWrongUsageOfRedisGroups) {
  const std::pair<std::vector<std::string>, const char*> cases[] = {
      {{"--store", "redis-groups:"}, "--store: redis-groups: has no FILE"},
      {{"--store", "redis-groups:file", "--store-max-bytes", "2000000"}, "set maxmemory in Redis instead"},
      {{"--divide-store"}, "--divide-store: is for --store redis-groups:FILE"}};
  for (const auto& [arguments, expected] : cases) {
    Program program(arguments);
    EXPECT_EQ(program.Wait(), 2) << expected;
    EXPECT_THAT(program.Stderr(), testing::HasSubstr(expected));
  }
}

TEST(ProgramTest, ReportsWrongUsageOfTheLoad) {
  const std::pair<std::vector<std::string>, const char*> cases[] = {
      {{"--max-load", "1"}, "--max-load: is 1; give 0 (no bound), or at least 0.1 and below 1"},
      {{"--load-listen", "9465"}, "--load-listen: address \"9465\" has no port; give HOST:PORT"},
      {{"--metrics-listen", "127.0.0.1:9464", "--load-listen", "127.0.0.1:9464"},
       "--load-listen: is the address of --metrics-listen: give another port"}};
  for (const auto& [arguments, expected] : cases) {
    Program program(arguments);
    EXPECT_EQ(program.Wait(), 2) << expected;
    EXPECT_THAT(program.Stderr(), testing::HasSubstr(expected));
  }
}

TEST(ProgramTest, ReadsTheBoundOfTheLoadFromTheEnvironment) {
  const ScopedEnvironmentVariable bound("EVPOSE_MAX_LOAD", "2");
  Program program({"--listen", "127.0.0.1:0"});
  EXPECT_EQ(program.Wait(), 2);
  EXPECT_THAT(program.Stderr(), testing::HasSubstr("--max-load: is 2; give 0 (no bound)"));
}

TEST(ProgramTest, ReportsWrongUsageOfThePoseLog) {
  Program program({"--listen", "127.0.0.1:0", "--pose-log-bytes", "4"});
  EXPECT_EQ(program.Wait(), 2);
  EXPECT_THAT(program.Stderr(), testing::HasSubstr("--pose-log-bytes: is 4; give at least 500000"));
}

TEST(ProgramTest, ReportsItsLoad) {
  Program program({"--listen", "127.0.0.1:0", "--load-listen", "127.0.0.1:0"});
  program.Announced("listening on 127.0.0.1:");
  const int port = PortOf(program.Announced("load on 127.0.0.1:"));
  ASSERT_GT(port, 0);
  EXPECT_EQ(HttpConnection(port).ReadAll(), "100%\n") << "without a session";

  Program second({"--listen", "127.0.0.1:0", "--load-listen", "127.0.0.1:" + std::to_string(port)});
  EXPECT_EQ(second.Wait(), 1);
  EXPECT_THAT(second.Stderr(), testing::ContainsRegex("evpose-server: --load-listen: cannot listen on [^\n]*\n$"));
  program.Signal(SIGTERM);
  EXPECT_EQ(program.Wait(), 0);
}

TEST(ProgramTest, AnAddressForMetricsThatIsNotOfThisMachine) {
  for (const char* address : {"192.0.2.1:0", "no.such.host.invalid:9464"}) {
    Program program({"--listen", "127.0.0.1:0", "--metrics-listen", address});
    EXPECT_EQ(program.Wait(), 1);
    EXPECT_THAT(program.Stderr(), testing::MatchesRegex("evpose-server: --metrics-listen: cannot listen on [^\n]*\n"));
  }
}

TEST(ProgramTest, PrintsVersionAndCommit) {
  Program program({"--version"});
  EXPECT_THAT(program.ReadLine(),
              testing::MatchesRegex("evpose-server [0-9]+\\.[0-9]+\\.[0-9]+ \\([0-9A-Za-z._-]+\\)"));
  EXPECT_EQ(program.Wait(), 0);
}

// The events of a log with one JSON object in each line.
std::vector<std::string> EventsOf(const std::string& log) {
  std::vector<std::string> events;
  for (const absl::string_view line : absl::StrSplit(log, '\n', absl::SkipEmpty())) {
    const auto json = nlohmann::json::parse(std::string(line), nullptr, false);
    if (!json.is_object()) {
      ADD_FAILURE() << "no JSON object: " << line;
      continue;
    }
    EXPECT_THAT(json.value("time", ""), testing::MatchesRegex("20[0-9-]+T[0-9:.]+[+-][0-9:]+")) << line;
    EXPECT_THAT(json.value("level", ""), testing::AnyOf("info", "warning", "error")) << line;
    events.push_back(json.value("event", ""));
  }
  return events;
}

TEST(ProgramTest, TheLogMayBeJson) {
  Program program({"--listen", "127.0.0.1:0", "--log-format", "json"});
  program.Announced("listening on ");
  program.Signal(SIGTERM);
  EXPECT_EQ(program.Wait(), 0);
  EXPECT_THAT(EventsOf(program.Stderr()), testing::ElementsAre("server_ready", "server_draining", "server_stopped"));

  const ScopedEnvironmentVariable format("EVPOSE_LOG_FORMAT", "json");
  const ScopedEnvironmentVariable level("EVPOSE_LOG_LEVEL", "off");
  {
    Program quiet({"--listen", "127.0.0.1:0"});
    quiet.Announced("listening on ");
    quiet.Signal(SIGTERM);
    EXPECT_EQ(quiet.Wait(), 0);
    EXPECT_EQ(quiet.Stderr(), "");
  }
  Program failing({"--listen", "127.0.0.1:0", "--port-file", "/no/such/directory/port"});
  EXPECT_EQ(failing.Wait(), 1);
  EXPECT_THAT(EventsOf(failing.Stderr()), testing::ElementsAre("server_failed"))
      << "the cause of the end is written at every level";
}

TEST(ProgramTest, AWrongVariableOfTheEnvironmentIsNamed) {
  const ScopedEnvironmentVariable level("EVPOSE_LOG_LEVEL", "loud");
  Program program({"--listen", "127.0.0.1:0"});
  EXPECT_EQ(program.Wait(), 2);
  EXPECT_THAT(program.Stderr(), testing::HasSubstr("the environment variable EVPOSE_LOG_LEVEL, which stands for "
                                                   "--log-level: \"loud\" is none of debug, info, "));
}

TEST(ProgramTest, HelpShowsAnExample) {
  Program program({"--help"});
  std::string text;
  for (std::string line = program.ReadLine(); !absl::StrContains(line, "can read a password");
       line = program.ReadLine()) {
    text += line + "\n";
    ASSERT_LT(text.size(), 100'000u);
  }
  EXPECT_EQ(program.Wait(), 0);
  EXPECT_THAT(text, testing::HasSubstr("evpose-server --listen 127.0.0.1:50051"));
}

TEST(ProgramTest, ListensForOtherMachinesWithInsecure) {
  Program program({"--listen", "0.0.0.0:0", "--insecure"});
  program.Announced("listening on 0.0.0.0:");
  program.Signal(SIGTERM);
  EXPECT_EQ(program.Wait(), 0);
}

}  // namespace
}  // namespace evpose::server
