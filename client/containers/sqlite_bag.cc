// SPDX-License-Identifier: Apache-2.0

// rosbag2 files of SQLite (.db3), as rosbag2_storage_sqlite3 writes them: tables topics (id, name, type,
// serialization_format) and messages (topic_id, timestamp, data).
#include <sqlite3.h>

#include <algorithm>
#include <filesystem>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "client/containers/bag.h"
#include "core/base/file_version.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr std::string_view kSqliteMagic("SQLite format 3\0", 16);

// Limit of a row of the topics, which also has the settings of all publishers: some 500 bytes each.
constexpr uint64_t kMaxTopicRowBytes = uint64_t{1} << 20;

struct CloseDatabase {
  void operator()(sqlite3* database) const { sqlite3_close(database); }
};
struct FinalizeStatement {
  void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
};
using Database = std::unique_ptr<sqlite3, CloseDatabase>;
using Statement = std::unique_ptr<sqlite3_stmt, FinalizeStatement>;

absl::Status DatabaseError(const std::string& path, sqlite3* database) {
  return absl::InvalidArgumentError(
      absl::StrCat(path, ": cannot be read as a rosbag2 file: ", sqlite3_errmsg(database)));
}

// A bag with a write-ahead log may grow while it is read: SQLite reads it as it was at first.
bool HasLog(const std::string& path) {
  std::error_code error;
  return std::filesystem::exists(path + "-wal", error);
}

// Values and rows above `max_bytes` are errors.
absl::StatusOr<Database> OpenDatabase(const std::string& path, uint64_t max_bytes) {
  // With "immutable" SQLite creates no files beside the bag, so that a folder without write permission suffices. A bag
  // with a write-ahead log is not immutable, because its latest pages are in the log.
  std::error_code error;
  const bool has_journal = HasLog(path);
  std::string uri =
      absl::StrReplaceAll(std::filesystem::absolute(path, error).string(), {{"%", "%25"}, {"?", "%3f"}, {"#", "%23"}});
  uri = absl::StrCat("file:", uri, has_journal ? "?mode=ro" : "?mode=ro&immutable=1");
  sqlite3* opened = nullptr;
  const int result = sqlite3_open_v2(uri.c_str(), &opened, SQLITE_OPEN_READONLY | SQLITE_OPEN_URI, nullptr);
  Database database(opened);
  if (result != SQLITE_OK) return DatabaseError(path, opened);
  sqlite3_limit(opened, SQLITE_LIMIT_LENGTH, static_cast<int>(max_bytes));
  // The only expressions of the file that SQLite evaluates are those of generated columns, with built-in functions that
  // have no effect outside. Other functions and views are not evaluated. The limit bounds the length of their values.
  sqlite3_db_config(opened, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
  sqlite3_db_config(opened, SQLITE_DBCONFIG_ENABLE_VIEW, 0, nullptr);
  return database;
}

absl::StatusOr<Statement> Prepare(const std::string& path, sqlite3* database, const char* query) {
  sqlite3_stmt* statement = nullptr;
  const int result = sqlite3_prepare_v2(database, query, -1, &statement, nullptr);
  Statement prepared(statement);
  if (result != SQLITE_OK) return DatabaseError(path, database);
  return prepared;
}

std::string TextOf(sqlite3_stmt* statement, int column) {
  const unsigned char* const text = sqlite3_column_text(statement, column);
  return text == nullptr ? "" : reinterpret_cast<const char*>(text);
}

absl::StatusOr<std::vector<BagTopic>> ReadTopics(const std::string& path, sqlite3* database) {
  EVPOSE_ASSIGN_OR_RETURN(
      const Statement statement,
      Prepare(path, database, "SELECT name, type, serialization_format FROM topics ORDER BY id LIMIT ?1"));
  sqlite3_bind_int64(statement.get(), 1, kMaxTopics);
  std::vector<BagTopic> topics;
  int result = SQLITE_OK;
  while ((result = sqlite3_step(statement.get())) == SQLITE_ROW) {
    BagTopic topic = {TextOf(statement.get(), 0), TextOf(statement.get(), 1), TextOf(statement.get(), 2)};
    const size_t longest = std::max({topic.name.size(), topic.type.size(), topic.encoding.size()});
    if (longest <= kMaxNameBytes) topics.push_back(std::move(topic));
  }
  if (result != SQLITE_DONE) return DatabaseError(path, database);
  return topics;
}

class SqliteStream final : public MessageStream {
 public:
  // `opened`: of the file at `path` if it must not change while it is read.
  SqliteStream(std::string path, std::optional<FileVersion> opened, Database database, Statement statement)
      : path_(std::move(path)),
        opened_(std::move(opened)),
        database_(std::move(database)),
        statement_(std::move(statement)) {}

  absl::StatusOr<bool> Next(std::string& message) override {
    if (is_at_end_) return false;
    const int result = sqlite3_step(statement_.get());
    if (result == SQLITE_ROW) {
      const void* const bytes = sqlite3_column_blob(statement_.get(), 0);
      const int size = sqlite3_column_bytes(statement_.get(), 0);
      message.assign(static_cast<const char*>(bytes), bytes == nullptr ? 0 : static_cast<size_t>(size));
      return true;
    }
    is_at_end_ = true;
    if (opened_.has_value()) {
      if (const absl::Status status = opened_->CheckUnchanged(); !status.ok()) {
        return absl::Status(status.code(), absl::StrCat(path_, ": ", status.message()));
      }
    }
    // The pages behind the damage cannot be found.
    num_damages_ += result != SQLITE_DONE ? 1 : 0;
    return false;
  }

  std::vector<SkippedParts> skipped() const override {
    if (num_damages_ == 0) return {};
    return {{"damaged rest of the file: messages may be missing at its end", num_damages_}};
  }

 private:
  const std::string path_;
  const std::optional<FileVersion> opened_;
  const Database database_;  // destroyed after the statement
  const Statement statement_;
  bool is_at_end_ = false;
  uint64_t num_damages_ = 0;
};

absl::StatusOr<std::unique_ptr<MessageStream>> OpenSqliteStream(const std::string& path, const BagTopic& topic) {
  std::optional<FileVersion> opened;
  if (!HasLog(path)) {
    EVPOSE_ASSIGN_OR_RETURN(opened, FileVersion::Of(path));
  }
  EVPOSE_ASSIGN_OR_RETURN(Database database, OpenDatabase(path, kMaxMessageBytes));
  // Reads in the order of the rows, which is that of their arrival, so that no row has to be sorted.
  EVPOSE_ASSIGN_OR_RETURN(
      Statement statement,
      Prepare(
          path, database.get(),
          "SELECT data FROM messages WHERE topic_id IN (SELECT id FROM topics WHERE name = ?1) ORDER BY messages.id"));
  if (sqlite3_bind_text(statement.get(), 1, topic.name.data(), static_cast<int>(topic.name.size()), SQLITE_TRANSIENT) !=
      SQLITE_OK) {
    return DatabaseError(path, database.get());
  }
  return std::make_unique<SqliteStream>(path, std::move(opened), std::move(database), std::move(statement));
}

bool MatchesSqlite(std::string_view prefix) { return prefix.starts_with(kSqliteMagic); }

absl::StatusOr<std::unique_ptr<RecordingReader>> OpenSqlite(ContainerFile file) {
  EVPOSE_ASSIGN_OR_RETURN(const Database database, OpenDatabase(file.path, kMaxTopicRowBytes));
  Bag bag = {.format = "rosbag2 SQLite"};
  EVPOSE_ASSIGN_OR_RETURN(bag.topics, ReadTopics(file.path, database.get()));
  bag.open = [path = file.path](const BagTopic& topic) { return OpenSqliteStream(path, topic); };
  return OpenBag(file, bag);
}

}  // namespace

const ContainerFormat kSqliteBagFormat = {
    .name = "rosbag2 (.db3)", .matches = MatchesSqlite, .open = OpenSqlite, .has_topics = true};

}  // namespace evpose::client
