// SPDX-License-Identifier: Apache-2.0
#include "server/stores/sqlite/sqlite_database.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

// Maximum wait for a lock: a process that copies or inspects the file locks it for a moment.
constexpr int kBusyTimeoutMs = 5000;

absl::Status MakeError(const std::string& path, int extended_code, const char* words) {
  const std::string message = absl::StrCat(path, ": ", words);
  switch (extended_code) {
    case SQLITE_IOERR_WRITE:
    case SQLITE_IOERR_SHMSIZE:
      return absl::ResourceExhaustedError(
          absl::StrCat(message, ": free space on its disk; deleted sessions leave free space in the file only"));
    case SQLITE_IOERR_FSYNC:
      return absl::UnavailableError(absl::StrCat(message, ": the disk did not confirm a write"));
    default:
      break;
  }
  switch (extended_code & 0xff) {
    case SQLITE_FULL:
      return absl::ResourceExhaustedError(absl::StrCat(
          message, ": free space on its disk or, if --store-max-bytes is reached, delete sessions or raise it"));
    case SQLITE_CORRUPT:
    case SQLITE_NOTADB:
      return absl::DataLossError(absl::StrCat(
          message, ": the file is damaged; restart the server, which copies the intact records to a new file"));
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return absl::UnavailableError(absl::StrCat(message, ": another process locks it"));
    case SQLITE_READONLY:
    case SQLITE_CANTOPEN:
    case SQLITE_PERM:
      return absl::PermissionDeniedError(
          absl::StrCat(message, ": the server needs to read and write this file, and to make files beside it"));
    default:
      return absl::InternalError(message);
  }
}

}  // namespace

absl::StatusOr<std::unique_ptr<SqliteDatabase>> SqliteDatabase::Connect(const std::string& path) {
  sqlite3* connection = nullptr;
  const int code = sqlite3_open_v2(path.c_str(), &connection,
                                   SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX, nullptr);
  if (code != SQLITE_OK) {
    const absl::Status error = MakeError(path, code, sqlite3_errstr(code));
    sqlite3_close_v2(connection);
    return error;
  }
  sqlite3_extended_result_codes(connection, 1);
  sqlite3_busy_timeout(connection, kBusyTimeoutMs);
  // The file may be damaged or malicious: no code in its schema is executed, and the structure of its pages is checked.
  sqlite3_db_config(connection, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
  sqlite3_db_config(connection, SQLITE_DBCONFIG_ENABLE_TRIGGER, 0, nullptr);
  sqlite3_db_config(connection, SQLITE_DBCONFIG_ENABLE_VIEW, 0, nullptr);
  std::unique_ptr<SqliteDatabase> database(new SqliteDatabase(path, connection));
  EVPOSE_RETURN_IF_ERROR(database->Execute("PRAGMA cell_size_check=ON"));
  // Memory mapping is off, because truncating a mapped file would end the process with SIGBUS.
  EVPOSE_RETURN_IF_ERROR(database->Execute("PRAGMA mmap_size=0"));
  return database;
}

absl::StatusOr<std::unique_ptr<SqliteDatabase>> SqliteDatabase::Open(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<SqliteDatabase> database, Connect(path));
  sqlite3_db_config(database->connection_, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  return database;
}

absl::StatusOr<std::unique_ptr<SqliteDatabase>> SqliteDatabase::OpenDamaged(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<SqliteDatabase> database, Connect(path));
  // With writable_schema, SQLite reads also a file that is shorter than declared in its header. query_only prevents
  // writes.
  EVPOSE_RETURN_IF_ERROR(database->Execute("PRAGMA writable_schema=ON"));
  EVPOSE_RETURN_IF_ERROR(database->Execute("PRAGMA query_only=ON"));
  return database;
}

SqliteDatabase::~SqliteDatabase() {
  for (const auto& [sql, statement] : statements_) sqlite3_finalize(statement);
  sqlite3_close_v2(connection_);
}

absl::Status SqliteDatabase::Execute(const std::string& sql) {
  const int code = sqlite3_exec(connection_, sql.c_str(), nullptr, nullptr, nullptr);
  return code == SQLITE_OK ? absl::OkStatus() : Error(code);
}

SqliteQuery SqliteDatabase::Query(const std::string& sql) {
  if (const auto found = statements_.find(sql); found != statements_.end()) {
    return SqliteQuery(*this, found->second, absl::OkStatus());
  }
  sqlite3_stmt* statement = nullptr;
  const int code = sqlite3_prepare_v3(connection_, sql.c_str(), static_cast<int>(sql.size()), SQLITE_PREPARE_PERSISTENT,
                                      &statement, nullptr);
  if (code != SQLITE_OK) return SqliteQuery(*this, nullptr, Error(code));
  statements_.emplace(sql, statement);
  return SqliteQuery(*this, statement, absl::OkStatus());
}

absl::Status SqliteDatabase::Error(int code) const {
  return MakeError(path_,
                   sqlite3_extended_errcode(connection_) != SQLITE_OK ? sqlite3_extended_errcode(connection_) : code,
                   sqlite3_errmsg(connection_));
}

SqliteQuery::~SqliteQuery() {
  if (statement_ == nullptr) return;
  sqlite3_reset(statement_);
  sqlite3_clear_bindings(statement_);
}

void SqliteQuery::Check(int code) {
  if (code != SQLITE_OK && status_.ok()) status_ = database_.Error(code);
}

SqliteQuery& SqliteQuery::Text(absl::string_view value) {
  const char* data = value.data() == nullptr ? "" : value.data();
  if (statement_ != nullptr) {
    Check(sqlite3_bind_text64(statement_, ++bound_, data, value.size(), SQLITE_STATIC, SQLITE_UTF8));
  }
  return *this;
}

SqliteQuery& SqliteQuery::Blob(absl::string_view value) {
  const char* data = value.data() == nullptr ? "" : value.data();
  if (statement_ != nullptr) Check(sqlite3_bind_blob64(statement_, ++bound_, data, value.size(), SQLITE_STATIC));
  return *this;
}

SqliteQuery& SqliteQuery::Integer(int64_t value) {
  if (statement_ != nullptr) Check(sqlite3_bind_int64(statement_, ++bound_, value));
  return *this;
}

SqliteQuery& SqliteQuery::Null() {
  if (statement_ != nullptr) Check(sqlite3_bind_null(statement_, ++bound_));
  return *this;
}

absl::Status SqliteQuery::Run() {
  while (Next()) {
  }
  return status_;
}

bool SqliteQuery::Next() {
  if (!status_.ok()) return false;
  const int code = sqlite3_step(statement_);
  if (code == SQLITE_ROW) return true;
  if (code != SQLITE_DONE) status_ = database_.Error(code);
  return false;
}

std::string SqliteQuery::BlobAt(int column) const {
  const void* data = sqlite3_column_blob(statement_, column);
  const int size = sqlite3_column_bytes(statement_, column);
  return data == nullptr ? std::string() : std::string(static_cast<const char*>(data), static_cast<size_t>(size));
}

}  // namespace evpose::server
