// SPDX-License-Identifier: Apache-2.0
#include "server/stores/postgres/postgres_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <future>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/poll_testing.h"
#include "server/stores/open_store.h"
#include "server/stores/postgres/postgres_records.h"
#include "server/stores/postgres/postgres_schema.h"
#include "server/stores/postgres/postgres_testing.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {
namespace {

using absl::StatusCode;
using testing::HasSubstr;
using testing::Not;

TEST(PostgresAddressTest, ReadsAllParts) {
  const PostgresAddress address =
      ParsePostgresAddress("postgresql://me:p%40ss@one:6000,two:6001/cameras?sslmode=verify-full").value();
  EXPECT_EQ(address.Get("user"), "me");
  EXPECT_EQ(address.Get("password"), "p@ss");
  EXPECT_EQ(address.Get("sslmode"), "verify-full");
  EXPECT_EQ(address.Get("target_session_attrs"), "read-write") << "a standby is not used";
  EXPECT_EQ(address.Printable(), "postgresql://one:6000,two:6001/cameras");
  EXPECT_EQ(ParsePostgresAddress("postgres://one,two/db?port=7")->Printable(), "postgresql://one:7,two:7/db");
  EXPECT_EQ(ParsePostgresAddress("postgresql://[::1]/db")->Printable(), "postgresql://[::1]/db");
  EXPECT_EQ(ParsePostgresAddress("postgresql:///db?host=/run/pg")->Printable(), "postgresql:///run/pg/db");
  EXPECT_TRUE(ParsePostgresAddress("postgresql://one/db?target_session_attrs=primary").ok());
}

TEST(PostgresAddressTest, ErrorsDoNotContainThePassword) {
  for (const char* const url :
       {"postgresql://me:secret@host", "postgresql://me:secret%4@host/db", "postgresql://me:secret@host/db?no=1",
        "postgresql://host/db?password=secret&x", "postgresql://me:secret@[host/db",
        "postgresql://me:secret@host/db?target_session_attrs=any",
        "postgresql://me:secret@host/db?target_session_attrs=standby"}) {
    const absl::Status status = ParsePostgresAddress(url).status();
    EXPECT_EQ(status.code(), StatusCode::kInvalidArgument) << url;
    EXPECT_THAT(std::string(status.message()), AllOf(Not(HasSubstr("secret")), HasSubstr("give postgresql://[USER")));
    EXPECT_EQ(OpenStore({.store = url}).status(), status);
  }
  EXPECT_THAT(std::string(ParsePostgresAddress("postgresql://host/db?colour=red").status().message()),
              HasSubstr("colour"));
}

TEST(PostgresAddressTest, TakesAPasswordFromElsewhere) {
  EXPECT_EQ(WithPostgresPassword("postgresql://me@host/db?x=@", "%41"), "postgresql://me:%41@host/db?x=@");
  EXPECT_EQ(WithPostgresPassword("postgresql://me:@host/db", "%41"), "postgresql://me:%41@host/db");
  EXPECT_EQ(WithPostgresPassword("postgresql://host?user=me", "%41"), "postgresql://:%41@host?user=me");
  EXPECT_EQ(ParsePostgresAddress(WithPostgresPassword("postgresql:///db?user=me", "%41"))->Get("password"), "A");
}

class PostgresStoreFixture : public testing::Test {
 protected:
  std::unique_ptr<Store> Open(absl::Duration timeout = absl::Seconds(60)) {
    PostgresStoreOptions options;
    options.client.address = ParsePostgresAddress(postgres_.url()).value();
    options.client.timeout = timeout;
    options.client.first_backoff = absl::ZeroDuration();
    return OpenPostgresStore(options).value();
  }
  absl::Status Refusal(const std::string& url) { return OpenStore({.store = url}).status(); }

  PostgresServer postgres_;
};

TEST_F(PostgresStoreFixture, WrongPasswordsAndMissingServersAreErrors) {
  postgres_.Run("CREATE ROLE keyed LOGIN SUPERUSER PASSWORD 'right-secret'");
  EXPECT_TRUE(OpenStore({.store = postgres_.url("keyed:right-secret")}).ok());
  for (const char* const user : {"keyed", "keyed:wrong-secret", "nobody:wrong-secret"}) {
    const absl::Status status = Refusal(postgres_.url(user));
    EXPECT_EQ(status.code(), StatusCode::kPermissionDenied) << status;
    EXPECT_THAT(std::string(status.message()), AllOf(Not(HasSubstr("secret")), HasSubstr(postgres_.host()),
                                                     HasSubstr("user and password of --store")));
  }
  const absl::Status missing = Refusal(postgres_.url("keyed:right-secret", "nowhere"));
  EXPECT_EQ(missing.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(missing.message()), AllOf(HasSubstr("\"nowhere\" does not exist"), HasSubstr("createdb")));
  postgres_.Kill();
  const absl::Status away = Refusal(postgres_.url("keyed:right-secret"));
  EXPECT_EQ(away.code(), StatusCode::kUnavailable) << away;
  EXPECT_THAT(std::string(away.message()), AllOf(Not(HasSubstr("secret")), HasSubstr("start PostgreSQL there")));
}

TEST_F(PostgresStoreFixture, AServerWithoutDurableCommitsIsRefused) {
  // A role's own setting is replaced.
  postgres_.Run("ALTER ROLE evpose SET synchronous_commit = off");
  const PostgresAddress address = ParsePostgresAddress(postgres_.url()).value();
  const auto setting = [&address](const char* before) {
    auto connection = PostgresConnection::Open(address, absl::Seconds(60)).value();
    EXPECT_TRUE(CreatePostgresSchema(*connection, "here").ok());
    EXPECT_TRUE(connection->Execute(before).ok());
    EXPECT_EQ(SetUpPostgresConnection(*connection, "here"), absl::OkStatus());
    return connection->Execute("SHOW synchronous_commit")->Bytes(0, 0);
  };
  EXPECT_EQ(setting("SELECT 1"), "on");
  EXPECT_EQ(setting("SET synchronous_commit = remote_write"), "on");
  EXPECT_EQ(setting("SET synchronous_commit = remote_apply"), "remote_apply") << "waits longer than `on`";
  // A server, or a proxy before it, that ignores the setting.
  postgres_.Run(
      "SET allow_system_table_mods = on; CREATE OR REPLACE FUNCTION pg_catalog.set_config(text, text, boolean) "
      "RETURNS text LANGUAGE sql AS 'SELECT pg_catalog.current_setting($1)'");
  const absl::Status ignored = Refusal(postgres_.url());
  EXPECT_EQ(ignored.code(), StatusCode::kFailedPrecondition) << ignored;
  EXPECT_THAT(std::string(ignored.message()), HasSubstr("synchronous_commit, which is off"));
  const PostgresServer careless({"fsync=off"});
  const absl::Status status = Refusal(careless.url());
  EXPECT_EQ(status.code(), StatusCode::kFailedPrecondition) << status;
  EXPECT_THAT(std::string(status.message()), HasSubstr("fsync = off"));
}

TEST_F(PostgresStoreFixture, ALaterSchemaIsRefused) {
  Open();
  postgres_.Run("UPDATE evpose.schema_version SET version = 99");
  const absl::Status later = Refusal(postgres_.url());
  EXPECT_EQ(later.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(later.message()), HasSubstr("schema version 99, later than version 1 of this server: use"));
  postgres_.Run("DELETE FROM evpose.schema_version");
  EXPECT_EQ(Refusal(postgres_.url()).code(), StatusCode::kDataLoss);
}

TEST_F(PostgresStoreFixture, ARoleThatMayNotCreateTheSchemaIsToldHow) {
  postgres_.Run("CREATE ROLE plain LOGIN");
  const absl::Status status = Refusal(postgres_.url("plain"));
  EXPECT_EQ(status.code(), StatusCode::kPermissionDenied) << status;
  EXPECT_THAT(std::string(status.message()), HasSubstr("grant CREATE on the database"));
  postgres_.Run("CREATE SCHEMA evpose AUTHORIZATION plain");
  EXPECT_TRUE(OpenStore({.store = postgres_.url("plain")}).ok());
}

TEST_F(PostgresStoreFixture, ServersThatStartTogetherCreateTheTablesOnce) {
  std::vector<std::thread> threads;
  std::atomic<int> opened = 0;
  for (int i = 0; i < 6; ++i) {
    threads.emplace_back([&] { opened += Open()->CheckHealth().ok() ? 1 : 0; });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(opened, 6);
  EXPECT_EQ(postgres_.Run("SELECT count(*) FROM evpose.schema_version"), "1");
}

TEST_F(PostgresStoreFixture, ReconnectsAfterARestartOfTheServer) {
  const std::unique_ptr<Store> store = Open();
  auto lease = store->CreateSession(Record("sessions/a"), "").value();
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3)}}).ok());
  postgres_.Kill();
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(CommitNow(*lease, {.checkpoint = "2", .poses = {Segment("a", 4, 5)}}).code(), StatusCode::kUnavailable);
  }
  EXPECT_EQ(store->ReadSession("sessions/a").status().code(), StatusCode::kUnavailable);
  EXPECT_EQ(store->CheckHealth().code(), StatusCode::kUnavailable);
  postgres_.Start();
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "3", .poses = {Segment("a", 4, 5), Segment("a", 6, 6)}}),
            absl::OkStatus());
  EXPECT_EQ(Ranges(store->ReadSession("sessions/a")->poses), "1-3 4-5 6-6");
  // The server restarts between two calls: the closed connections are noticed before they are used.
  postgres_.Stop();
  postgres_.Start();
  EXPECT_EQ(Ranges(store->ReadSession("sessions/a")->poses), "1-3 4-5 6-6");
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "4", .poses = {Segment("a", 7, 8)}}), absl::OkStatus());
  EXPECT_EQ(store->ReadSession("sessions/a")->checkpoint, "4");
}

// A primary that was replaced, and has not ended its connections.
TEST_F(PostgresStoreFixture, AServerThatBecomesReadOnlyIsLeft) {
  const std::unique_ptr<Store> store = Open();
  auto lease = store->CreateSession(Record("sessions/a"), "").value();
  postgres_.Run("ALTER SYSTEM SET default_transaction_read_only = on");
  postgres_.Run("SELECT pg_reload_conf()");
  absl::Status status;
  ASSERT_TRUE(Poll([&] {
    status = CommitNow(*lease, {.checkpoint = "1"});
    return !status.ok();
  }));
  EXPECT_EQ(status.code(), StatusCode::kUnavailable) << status;
  status = CommitNow(*lease, {.checkpoint = "1"});
  EXPECT_EQ(status.code(), StatusCode::kUnavailable) << status;
  EXPECT_THAT(std::string(status.message()), HasSubstr("session is read-only")) << "it looks for another server";
  postgres_.Run("ALTER SYSTEM RESET default_transaction_read_only");
  postgres_.Run("SELECT pg_reload_conf()");
  ASSERT_TRUE(Poll([&] { return CommitNow(*lease, {.checkpoint = "2"}).ok(); }));
  EXPECT_EQ(store->ReadSession("sessions/a")->checkpoint, "2");
}

TEST_F(PostgresStoreFixture, ThePreviousHolderOnAnotherServerIsFenced) {
  const std::unique_ptr<Store> one = Open();
  const std::unique_ptr<Store> other = Open();
  auto lease = one->CreateSession(Record("sessions/a"), "").value();
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3)}}).ok());
  Store::AcquiredSession acquired = other->AcquireSession("sessions/a").value();
  EXPECT_EQ(CommitNow(*lease, {.checkpoint = "x", .poses = {Segment("x", 4, 4)}}).code(), StatusCode::kAborted);
  EXPECT_TRUE(CommitNow(*acquired.lease, {.checkpoint = "2", .poses = {Segment("a", 4, 4)}}).ok());
  EXPECT_EQ(one->AcquireSession("sessions/a")->session.checkpoint, "2");
  EXPECT_EQ(CommitNow(*acquired.lease, {.checkpoint = "x"}).code(), StatusCode::kAborted);
}

TEST_F(PostgresStoreFixture, ALockedSessionDoesNotStopTheOthers) {
  const std::unique_ptr<Store> store = Open();
  std::vector<std::unique_ptr<SessionLease>> leases;
  for (const char* const name : {"sessions/a", "sessions/b", "sessions/c"}) {
    leases.push_back(store->CreateSession(Record(name), "").value());
  }
  auto other = PostgresConnection::Open(ParsePostgresAddress(postgres_.url()).value(), absl::Seconds(60)).value();
  ASSERT_TRUE(other->Execute("BEGIN; SELECT FROM evpose.leases WHERE session = 'sessions/b' FOR UPDATE").ok());
  std::vector<std::promise<absl::Status>> outcomes(3);
  for (size_t i = 0; i < 3; ++i) {
    leases[i]->Commit({.checkpoint = "1"}, [&, i](absl::Status status) { outcomes[i].set_value(std::move(status)); });
  }
  EXPECT_EQ(outcomes[0].get_future().get(), absl::OkStatus());
  const absl::Status locked = outcomes[1].get_future().get();
  EXPECT_EQ(locked.code(), StatusCode::kUnavailable);
  EXPECT_THAT(std::string(locked.message()), HasSubstr("lock timeout"));
  EXPECT_EQ(outcomes[2].get_future().get(), absl::OkStatus());
  ASSERT_TRUE(other->Execute("COMMIT").ok());
  EXPECT_EQ(CommitNow(*leases[1], {.checkpoint = "2"}), absl::OkStatus());
}

// The names of a client are values and never a part of a statement; all bytes are allowed.
TEST_F(PostgresStoreFixture, HostileNamesAreOnlyBytes) {
  const std::unique_ptr<Store> store = Open();
  const std::vector<std::string> hostile = {
      "'; DROP TABLE evpose.sessions; --", std::string("a\0b", 3), "\xff\xfe", "$1", "\\", "%s", "\"", "\xc0\x80"};
  for (size_t i = 0; i < hostile.size(); ++i) {
    const std::string name = absl::StrCat("sessions/", hostile[i]);
    auto lease =
        store->CreateSession({.name = name, .tenant = hostile[i], .request_id = hostile[i]}, hostile[i]).value();
    EXPECT_EQ(CommitNow(*lease, {.checkpoint = hostile[i]}), absl::OkStatus());
    EXPECT_EQ(store->FindRequest(hostile[i], hostile[i])->name, name);
    EXPECT_EQ(store->ListSessions(hostile[i], "", 10)->records.size(), 1u);
    EXPECT_EQ(store->ReadSession(name)->checkpoint, hostile[i]);
    EXPECT_EQ(store->ReadTenant(name).value(), hostile[i]);
  }
  EXPECT_EQ(store->ListOwners()->size(), hostile.size());
  EXPECT_TRUE(store->DeleteSession("sessions/" + hostile[0]).ok());
  EXPECT_EQ(store->ListOwners()->size(), hostile.size() - 1);
}

TEST_F(PostgresStoreFixture, NamesDamagedRecords) {
  std::unique_ptr<Store> store = Open();
  const std::pair<const char*, const char*> cases[] = {
      {"UPDATE evpose.leases SET checkpoint = 'other bytes'", "checkpoint of sessions/a"},
      {"UPDATE evpose.sessions SET lifecycle = ''", "lifecycle of sessions/a"},
      {"UPDATE evpose.sessions SET record = 'other'", "record of sessions/a"},
      {"DELETE FROM evpose.poses WHERE first_pose_seq = 4", "poses of sessions/a are missing"},
      {"UPDATE evpose.poses SET bytes = 'x' WHERE first_pose_seq = 4", "poses 4 to 5 of sessions/a"},
  };
  for (const auto& [tamper, words] : cases) {
    ASSERT_TRUE(store->DeleteSession("sessions/a").ok());
    auto lease = store->CreateSession(Record("sessions/a"), "").value();
    ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3), Segment("a", 4, 5)}}).ok());
    postgres_.Run(tamper);
    const absl::Status status = store->AcquireSession("sessions/a").status();
    EXPECT_EQ(status.code(), StatusCode::kDataLoss) << words;
    EXPECT_THAT(std::string(status.message()), HasSubstr(words));
    EXPECT_EQ(store->ReadWithoutPoses({"sessions/a"})->size(), absl::StrContains(words, "poses") ? 1u : 0u) << words;
    EXPECT_THAT(Open()->damage(), testing::ElementsAre(AllOf(HasSubstr("session sessions/a: "), HasSubstr(words))));
  }
  ASSERT_TRUE(store->DeleteSession("sessions/a").ok());
  ASSERT_TRUE(store->PutModel(Model("models/a", "", "bytes")).ok());
  postgres_.Run("UPDATE evpose.models SET bytes = 'other bytes, as many'");
  store = Open();
  EXPECT_THAT(store->damage(), testing::ElementsAre(HasSubstr("model models/a")));
}

TEST_F(PostgresStoreFixture, CallsUseIndexes) {
  Open();
  postgres_.Run(
      "INSERT INTO evpose.sessions SELECT convert_to('s' || i, 'UTF8'), convert_to('t' || i % 100, 'UTF8'), "
      "convert_to('r' || i, 'UTF8'), '', '', i FROM generate_series(1, 20000) i; INSERT INTO evpose.leases SELECT "
      "name, "
      "1, '', 0, 1, 1, lifecycle_write, 1, NULL FROM evpose.sessions; INSERT INTO evpose.poses SELECT name, n, n, '' "
      "FROM evpose.sessions, generate_series(1, 3) n; INSERT INTO evpose.models SELECT convert_to('m' || i, 'UTF8'), "
      "convert_to('t' || i % 100, 'UTF8'), '', '' FROM generate_series(1, 20000) i; ANALYZE");
  const std::pair<const PostgresStatement*, const char*> cases[] = {
      {&kPostgresLock, "'s7'"},
      {&kPostgresReadSession, "'s7'"},
      {&kPostgresReadPoses, "'s7', 1"},
      {&kPostgresReadTenant, "'s7'"},
      {&kPostgresListSessions, "'t7', 's7', 50"},
      {&kPostgresFindRequest, "'t7', 'r7'"},
      {&kPostgresOldestLifecycles, "100, 50"},
      {&kPostgresHasModel, "'m7', 't7'"},
      {&kPostgresLockEnded, "100, 50"},
      {&kPostgresAcquire, "'s7', 'holder'"},
      {&kPostgresDeletePoses, "'s7'"},
      {&kPostgresDeleteSession, "'s7'"},
  };
  for (const auto& [statement, values] : cases) {
    const std::string plan =
        postgres_.Run(absl::StrCat("PREPARE p AS ", statement->sql, "; EXPLAIN (FORMAT JSON) EXECUTE p(", values, ")"));
    EXPECT_THAT(plan, AllOf(HasSubstr("Index"), Not(HasSubstr("Seq Scan")))) << statement->name;
  }
}

}  // namespace
}  // namespace evpose::server
