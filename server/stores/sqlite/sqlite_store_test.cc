// SPDX-License-Identifier: Apache-2.0
#include "server/stores/sqlite/sqlite_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <random>

#include "absl/strings/match.h"
#include "absl/strings/str_join.h"
#include "core/base/output_file.h"
#include "server/runtime/failing_allocations_testing.h"
#include "server/runtime/out_of_memory.h"
#include "server/stores/open_store.h"
#include "server/stores/sqlite/sqlite_database.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {
namespace {

using absl::StatusCode;
using testing::AllOf;
using testing::HasSubstr;

void WriteAll(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

mode_t Mode(const std::string& path) {
  struct stat found = {};
  stat(path.c_str(), &found);
  return found.st_mode & 0777;
}

class SqliteStoreTest : public testing::Test {
 protected:
  std::string DataDir() const { return directory_.path() + "/data"; }
  std::string File() const { return DataDir() + "/evpose.db"; }
  absl::StatusOr<std::unique_ptr<Store>> TryOpen() { return OpenStore({.store = "sqlite", .data_dir = DataDir()}); }
  std::unique_ptr<Store> Open() { return TryOpen().value(); }
  void Execute(const std::string& sql) { ASSERT_TRUE(SqliteDatabase::Open(File()).value()->Execute(sql).ok()) << sql; }

  static std::string Name(int session) { return "sessions/" + std::to_string(session); }
  static constexpr int kSessions = 6;
  static SessionRecord RecordWithRequest(const std::string& name) {
    SessionRecord record = Record(name);
    record.request_id = "request of " + name;
    return record;
  }
  void Fill() {
    const std::unique_ptr<Store> store = Open();
    for (int i = 0; i < kSessions; ++i) {
      auto lease = store->CreateSession(RecordWithRequest(Name(i)), "life " + std::to_string(i)).value();
      ASSERT_TRUE(CommitNow(*lease, {.checkpoint = Noise(40'000, static_cast<uint64_t>(i)),
                                     .poses = {Segment(Name(i), 1, 5), Segment(Name(i), 6, 9)}})
                      .ok());
    }
    ASSERT_TRUE(store->PutModel(Model("models/a", "", Noise(30'000, 7))).ok());
  }
  // Makes the closed file one of an earlier version, which had no indexes.
  void MakeFirstSchema() {
    for (const char* const index : {"sessions_of_tenant", "sessions_of_request", "sessions_by_lifecycle_write"}) {
      Execute(absl::StrCat("DROP INDEX ", index));
    }
    for (const char* const column : {"tenant", "request_id", "lifecycle_write"}) {
      Execute(absl::StrCat("ALTER TABLE sessions DROP COLUMN ", column));
    }
    Execute("PRAGMA user_version=1");
  }
  static bool IsWhole(const StoredSession& session, int i) {
    return session.lifecycle == "life " + std::to_string(i) && session.checkpoint == Noise(40'000, i) &&
           Ranges(session.poses) == "1-5 6-9" && session.poses[1].bytes == Segment(Name(i), 6, 9).bytes;
  }

  const TemporaryDirectory directory_;
};

// Whichever allocation fails while a session is read, the next reading begins its own transaction.
TEST_F(SqliteStoreTest, AFailedAllocationDoesNotLeaveTheReaderInATransaction) {
  Fill();
  const std::unique_ptr<Store> store = Open();
  int num_failed = 0;
  bool has_failed = true;
  for (int number = 0; has_failed; ++number) {
    has_failed = FailsAllocation(
        number, [&] { num_failed += !OrOutOfMemory([&] { return store->ReadSession(Name(0), 0); }).ok(); });
    const auto again = store->ReadSession(Name(0), 0);
    ASSERT_TRUE(again.ok()) << number << ": " << again.status();
  }
  EXPECT_GT(num_failed, 10);
}

TEST_F(SqliteStoreTest, FilesAreAccessibleForTheirOwnerOnly) {
  const std::unique_ptr<Store> store = Open();
  ASSERT_TRUE(store->CreateSession(Record("sessions/a"), "").ok());
  EXPECT_EQ(Mode(DataDir()), 0700u);
  for (const auto& entry : std::filesystem::directory_iterator(DataDir())) {
    EXPECT_EQ(Mode(entry.path()), 0600u) << entry.path();
  }
}

TEST_F(SqliteStoreTest, OneServerHoldsADirectory) {
  std::unique_ptr<Store> store = Open();
  const absl::Status second = TryOpen().status();
  EXPECT_EQ(second.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(second.message()), AllOf(HasSubstr(DataDir()), HasSubstr("in use by another server")));
  store.reset();
  EXPECT_TRUE(TryOpen().ok());
}

TEST_F(SqliteStoreTest, UnusableDirectoriesAreErrors) {
  const absl::Status none = OpenStore({.store = "sqlite"}).status();
  EXPECT_EQ(none.code(), StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(none.message()), HasSubstr("--data-dir"));
  const absl::Status missing = OpenStore({.store = "sqlite", .data_dir = DataDir() + "/below/it"}).status();
  EXPECT_EQ(missing.code(), StatusCode::kNotFound);
  EXPECT_THAT(std::string(missing.message()), AllOf(HasSubstr(DataDir()), HasSubstr("--data-dir")));
  WriteAll(DataDir(), "a file");
  const absl::Status file = TryOpen().status();
  EXPECT_EQ(file.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(file.message()), AllOf(HasSubstr(DataDir()), HasSubstr("--data-dir")));
  // No user can create a directory in /sys, not even root.
  const absl::Status denied = OpenStore({.store = "sqlite", .data_dir = "/sys/evpose"}).status();
  EXPECT_EQ(denied.code(), StatusCode::kPermissionDenied) << denied;
  EXPECT_THAT(std::string(denied.message()), AllOf(HasSubstr("/sys/evpose"), HasSubstr("--data-dir")));
  EXPECT_EQ(OpenStore({.store = "postgres"}).status().code(), StatusCode::kInvalidArgument);
}

TEST_F(SqliteStoreTest, OtherFilesAreRejectedAndNotChanged) {
  std::filesystem::create_directory(DataDir());
  WriteAll(File(), "a text of somebody's");
  const absl::Status text = TryOpen().status();
  EXPECT_EQ(text.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(text.message()), AllOf(HasSubstr(File()), HasSubstr("no SQLite database")));
  EXPECT_EQ(ReadFile(File(), SIZE_MAX).value(), "a text of somebody's");

  std::filesystem::remove(File());
  Execute("CREATE TABLE others (a); PRAGMA user_version=3");
  const absl::Status other = TryOpen().status();
  EXPECT_EQ(other.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(other.message()), HasSubstr("another program's"));

  std::filesystem::remove(File());
  Open().reset();
  Execute("PRAGMA user_version=9");
  const absl::Status newer = TryOpen().status();
  EXPECT_EQ(newer.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(newer.message()), AllOf(HasSubstr("newer evpose"), HasSubstr("schema 9")));
}

TEST_F(SqliteStoreTest, AnIncompleteNewFileIsCompleted) {
  std::filesystem::create_directory(DataDir());
  Execute("PRAGMA page_size=16384; PRAGMA journal_mode=WAL");
  EXPECT_TRUE(Open()->CreateSession(Record("sessions/a"), "").ok());
  std::filesystem::remove(File());
  WriteAll(File(), "");
  EXPECT_TRUE(Open()->CreateSession(Record("sessions/a"), "").ok());
}

TEST_F(SqliteStoreTest, NamesDamagedRecordsAndRescuesTheOthers) {
  const std::pair<const char*, const char*> cases[] = {
      {"UPDATE sessions SET lifecycle = x'00112233' WHERE name = 'sessions/2'", "lifecycle of sessions/2"},
      {"UPDATE sessions SET ended_at_ns = 1 WHERE name = 'sessions/2'", "end of sessions/2"},
      {"UPDATE checkpoints SET bytes = (SELECT bytes FROM checkpoints WHERE session = 'sessions/1') WHERE session = "
       "'sessions/2'",
       "checkpoint of sessions/2"},
      {"DELETE FROM checkpoints WHERE session = 'sessions/2'", "checkpoint of sessions/2"},
      {"UPDATE poses SET last_pose_seq = 10 WHERE session = 'sessions/2' AND first_pose_seq = 6", "of sessions/2"},
      {"DELETE FROM poses WHERE session = 'sessions/2' AND first_pose_seq = 1", "poses of sessions/2 are missing"},
      {"DELETE FROM poses WHERE session = 'sessions/2'", "poses of sessions/2 are missing"},
      {"DELETE FROM sessions WHERE name = 'sessions/2'", "sessions/2: its record is missing"},
      {"UPDATE sessions SET state = (SELECT state FROM sessions WHERE name = 'sessions/1') WHERE name = 'sessions/2'",
       "state of sessions/2"},
  };
  for (const auto& [sql, words] : cases) {
    std::filesystem::remove_all(DataDir());
    Fill();
    Execute(sql);
    std::unique_ptr<Store> store = Open();
    EXPECT_THAT(absl::StrJoin(store->damage(), "\n"), AllOf(HasSubstr(words), HasSubstr("evpose.db.damaged-1")));
    EXPECT_TRUE(std::filesystem::exists(File() + ".damaged-1"));
    EXPECT_EQ(store->AcquireSession("sessions/2").status().code(), StatusCode::kDataLoss) << sql;
    EXPECT_EQ(store->ReadSession("sessions/2").status().code(), StatusCode::kDataLoss);
    EXPECT_EQ(store->ReadWithoutPoses({"sessions/2", "sessions/1"})->size(), 1u) << sql;
    EXPECT_EQ(store->CreateSession(Record("sessions/2"), "").status().code(), StatusCode::kAlreadyExists);
    EXPECT_EQ(store->ListOwners()->size(), kSessions - 1u);
    for (const int i : {0, 1, 3, 4, 5}) EXPECT_TRUE(IsWhole(store->ReadSession(Name(i)).value(), i)) << sql;
    EXPECT_TRUE(store->ReadModel("", "models/a").ok());
    EXPECT_TRUE(store->DeleteSession("sessions/2").ok());
    EXPECT_TRUE(store->CreateSession(Record("sessions/2"), "").ok());
    store.reset();
    EXPECT_THAT(Open()->damage(), testing::IsEmpty()) << "the rescued file is intact";
  }
}

TEST_F(SqliteStoreTest, AWrongIndexIsMadeAgain) {
  Fill();
  Execute("UPDATE sessions SET tenant = 'another' WHERE name = 'sessions/2'");
  const std::unique_ptr<Store> store = Open();
  EXPECT_THAT(absl::StrJoin(store->damage(), "\n"), HasSubstr("the index of session sessions/2"));
  EXPECT_TRUE(store->ListSessions("another", "", 10)->records.empty());
  EXPECT_EQ(store->ListSessions(Record("sessions/2").tenant, "", 10)->records.size(), 1u);
  EXPECT_EQ(store->ListOwners()->size(), static_cast<size_t>(kSessions));
}

TEST_F(SqliteStoreTest, AFileOfTheFirstSchemaIsUpgraded) {
  Fill();
  MakeFirstSchema();
  for (int i = 0; i < 2; ++i) {
    const std::unique_ptr<Store> store = Open();
    EXPECT_THAT(store->damage(), testing::IsEmpty());
    const SessionRecord record = RecordWithRequest("sessions/2");
    EXPECT_EQ(store->ListSessions(record.tenant, "", 10)->records.size(), 1u);
    EXPECT_EQ(store->FindRequest(record.tenant, record.request_id)->name, record.name);
    EXPECT_EQ(store->ReadOldestLifecycles(100)->size(), static_cast<size_t>(kSessions));
    EXPECT_TRUE(IsWhole(store->ReadSession("sessions/2").value(), 2));
  }
}

TEST_F(SqliteStoreTest, ADamagedFileOfTheFirstSchemaIsRescued) {
  Fill();
  MakeFirstSchema();
  const std::string whole_file = ReadFile(File(), SIZE_MAX).value();
  for (size_t at = 4096; at < whole_file.size(); at += 16384) {
    std::string bytes = whole_file;
    std::fill(bytes.begin() + static_cast<ptrdiff_t>(at), bytes.begin() + static_cast<ptrdiff_t>(at) + 512, '\xff');
    std::filesystem::remove_all(DataDir());
    std::filesystem::create_directory(DataDir());
    WriteAll(File(), bytes);
    const auto store = TryOpen();
    ASSERT_TRUE(store.ok()) << at << ": " << store.status();
    const std::string damage = absl::StrJoin((*store)->damage(), "\n");
    EXPECT_THAT(damage, testing::Not(HasSubstr("the index of session"))) << at;
    for (int i = 0; i < kSessions; ++i) {
      const auto session = (*store)->ReadSession(Name(i));
      if (!session.ok()) continue;
      EXPECT_TRUE(IsWhole(*session, i)) << at;
      EXPECT_EQ((*store)->ReadTenant(Name(i)).value(), Record(Name(i)).tenant) << at;
    }
  }
}

TEST_F(SqliteStoreTest, FencingNumbersRiseAfterDamage) {
  Fill();
  const uint64_t last = Open()->AcquireSession("sessions/3")->lease->token().number;
  Execute("DELETE FROM fencing");
  const std::unique_ptr<Store> store = Open();
  EXPECT_THAT(absl::StrJoin(store->damage(), "\n"), HasSubstr("fencing number"));
  EXPECT_GT(store->CreateSession(Record("sessions/new"), "").value()->token().number, last);
}

TEST_F(SqliteStoreTest, ADamagedModelIsNamedAndLeftOut) {
  Fill();
  Execute("UPDATE models SET bytes = x'00'");
  const std::unique_ptr<Store> store = Open();
  EXPECT_THAT(absl::StrJoin(store->damage(), "\n"), HasSubstr("model models/a: the file of models/a is damaged"));
  EXPECT_TRUE(store->ListModels()->empty());
  EXPECT_EQ(store->ListOwners()->size(), static_cast<size_t>(kSessions));
}

TEST_F(SqliteStoreTest, ALargeFileIsCheckedAfterDamageHasBeenRead) {
  Fill();
  Execute("UPDATE models SET bytes = x'00'");
  const SqliteStoreOptions options = {.data_dir = DataDir(), .max_checked_bytes = 0};
  {
    const std::unique_ptr<Store> store = OpenSqliteStore(options).value();
    EXPECT_THAT(store->damage(), testing::IsEmpty()) << "the start does not read all records";
    EXPECT_EQ(store->ReadModel("", "models/a").status().code(), StatusCode::kDataLoss);
    EXPECT_TRUE(store->HasModel("", "models/a").value());
  }
  EXPECT_THAT(absl::StrJoin(OpenSqliteStore(options).value()->damage(), "\n"), HasSubstr("model models/a"));
  EXPECT_THAT(OpenSqliteStore(options).value()->damage(), testing::IsEmpty()) << "the rescued file is intact";
}

// Changes one byte, zeroes a block, or truncates the file, at random places. Nothing crashes, and every session that
// can be read is unchanged.
TEST_F(SqliteStoreTest, RandomDamageNeverChangesASession) {
  Fill();
  const std::string whole_file = ReadFile(File(), SIZE_MAX).value();
  std::mt19937_64 random(1);
  int with_damage = 0;
  int with_survivors = 0;
  constexpr int kTrials = 60;
  for (int trial = 0; trial < kTrials; ++trial) {
    std::string bytes = whole_file;
    const size_t at = random() % bytes.size();
    if (trial % 3 == 0) bytes[at] = static_cast<char>(bytes[at] ^ static_cast<char>(1 + random() % 255));
    if (trial % 3 == 1) std::fill(bytes.begin() + at, bytes.begin() + std::min(at + 4096, bytes.size()), '\0');
    if (trial % 3 == 2) bytes.resize(at);
    std::filesystem::remove_all(DataDir());
    std::filesystem::create_directory(DataDir());
    WriteAll(File(), bytes);
    const auto store = TryOpen();
    if (!store.ok()) {
      EXPECT_LT(at, 4096u) << "only a file without its header is rejected: " << store.status();
      continue;
    }
    const std::string damage = absl::StrJoin((*store)->damage(), "\n");
    int survivors = 0;
    for (int i = 0; i < kSessions; ++i) {
      const auto session = (*store)->ReadSession(Name(i));
      if (session.ok()) {
        ++survivors;
        EXPECT_TRUE(IsWhole(*session, i)) << "trial " << trial << " at " << at;
      } else {
        EXPECT_TRUE(absl::StrContains(damage, Name(i)) || absl::StrContains(damage, "list of sessions")) << damage;
      }
    }
    with_damage += damage.empty() ? 0 : 1;
    with_survivors += !damage.empty() && survivors > 0 ? 1 : 0;
    EXPECT_TRUE((*store)->CreateSession(Record("sessions/new"), "").ok()) << "trial " << trial << " at " << at;
  }
  EXPECT_GE(with_damage, kTrials / 2);
  EXPECT_GE(with_survivors, kTrials / 4);
}

TEST_F(SqliteStoreTest, AnEmptyFileWithALogIsNotTreatedAsNew) {
  std::unique_ptr<Store> store = Open();
  ASSERT_TRUE(store->CreateSession(Record("sessions/a"), "").ok());
  const std::string log = ReadFile(File() + "-wal", SIZE_MAX).value();
  ASSERT_FALSE(log.empty());
  store.reset();
  WriteAll(File(), "");
  WriteAll(File() + "-wal", log);
  EXPECT_THAT(absl::StrJoin(Open()->damage(), "\n"), HasSubstr("list of sessions"));
}

// The state after a crash: the log has not been copied into the file.
TEST_F(SqliteStoreTest, ADamagedLogIsNamed) {
  std::unique_ptr<Store> store = Open();
  auto lease = store->CreateSession(Record("sessions/a"), "").value();
  for (uint64_t i = 1; i <= 5; ++i) ASSERT_TRUE(CommitNow(*lease, {.poses = {Segment("a", i, i)}}).ok());
  const std::string file = ReadFile(File(), SIZE_MAX).value();
  const std::string log = ReadFile(File() + "-wal", SIZE_MAX).value();
  store.reset();
  const auto damage_with = [&](const std::string& bytes) {
    std::filesystem::remove_all(DataDir());
    std::filesystem::create_directory(DataDir());
    WriteAll(File(), file);
    WriteAll(File() + "-wal", bytes);
    return absl::StrJoin(Open()->damage(), "\n");
  };
  const auto with_byte_changed = [&](size_t at) {
    std::string bytes = log;
    bytes[at] = static_cast<char>(bytes[at] ^ 1);
    return bytes;
  };
  EXPECT_EQ(damage_with(log), "");
  EXPECT_EQ(damage_with(log.substr(0, log.size() - 100)), "") << "as a crash leaves it";
  EXPECT_EQ(damage_with(with_byte_changed(log.size() - 100)), "") << "as a crash may leave it";
  EXPECT_THAT(damage_with(with_byte_changed(log.size() / 2)), HasSubstr("damaged in its middle"));
  EXPECT_THAT(damage_with(with_byte_changed(20)), HasSubstr("header of the log"));
}

// Simulates a full disk with a limit on the size of files.
TEST_F(SqliteStoreTest, AFullDiskRejectsOnlyTheCommit) {
  const std::unique_ptr<Store> store = Open();
  auto lease = store->CreateSession(Record("sessions/a"), "").value();
  ASSERT_TRUE(CommitNow(*lease, {.checkpoint = "1", .poses = {Segment("a", 1, 3)}}).ok());
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit limit = {};
  getrlimit(RLIMIT_FSIZE, &limit);
  const rlimit small = {.rlim_cur = 1u << 20, .rlim_max = limit.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  const absl::Status full = CommitNow(*lease, {.checkpoint = Noise(3u << 20, 1), .poses = {Segment("a", 4, 5)}});
  setrlimit(RLIMIT_FSIZE, &limit);
  EXPECT_EQ(full.code(), StatusCode::kResourceExhausted) << full;
  EXPECT_THAT(std::string(full.message()), AllOf(HasSubstr(File()), HasSubstr("free space")));
  EXPECT_EQ(store->ReadSession("sessions/a")->checkpoint, "1");
  EXPECT_TRUE(CommitNow(*lease, {.checkpoint = Noise(3u << 20, 1), .poses = {Segment("a", 4, 5)}}).ok());
  EXPECT_EQ(Ranges(store->ReadSession("sessions/a")->poses), "1-3 4-5");
}

TEST_F(SqliteStoreTest, FileAndLogStayWithinTheLimit) {
  constexpr uint64_t kLimit = 4u << 20;
  const std::unique_ptr<Store> store = OpenSqliteStore({.data_dir = DataDir(), .max_bytes = kLimit}).value();
  for (int i = 0; i < 40; ++i) {
    const std::string name = "sessions/" + std::to_string(i);
    auto lease = store->CreateSession(Record(name), "").value();
    ASSERT_TRUE(CommitNow(*lease, {.checkpoint = Noise(256u << 10, static_cast<uint64_t>(i))}).ok()) << i;
    ASSERT_TRUE(store->DeleteSession(name).ok());
  }
  const uint64_t bytes = std::filesystem::file_size(File()) + std::filesystem::file_size(File() + "-wal");
  EXPECT_LE(bytes, kLimit);
}

}  // namespace
}  // namespace evpose::server
