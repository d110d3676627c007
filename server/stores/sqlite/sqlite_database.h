// SPDX-License-Identifier: Apache-2.0

// SQLite's C interface as values and statuses.
#pragma once

#include <sqlite3.h>

#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace evpose::server {

class SqliteQuery;

// One connection, with the statements it has prepared. For one thread at a time.
class SqliteDatabase {
 public:
  // Makes the file when it is not there. Errors name the path.
  static absl::StatusOr<std::unique_ptr<SqliteDatabase>> Open(const std::string& path);
  // To read what can be read of a file that Open() finds damaged.
  static absl::StatusOr<std::unique_ptr<SqliteDatabase>> OpenDamaged(const std::string& path);
  ~SqliteDatabase();
  SqliteDatabase(const SqliteDatabase&) = delete;
  SqliteDatabase& operator=(const SqliteDatabase&) = delete;

  const std::string& path() const { return path_; }

  // Statements without values. Errors: RESOURCE_EXHAUSTED for a full disk or quota, DATA_LOSS for a damaged file,
  // UNAVAILABLE while another process locks it, PERMISSION_DENIED, INTERNAL; all in SQLite's words, with path and
  // advice.
  absl::Status Execute(const std::string& sql);
  // The statement is prepared once and kept. Errors show when the query runs.
  SqliteQuery Query(const std::string& sql);

  bool InTransaction() const { return sqlite3_get_autocommit(connection_) == 0; }
  // Rows changed since opening.
  int64_t total_changes() const { return sqlite3_total_changes64(connection_); }

 private:
  friend class SqliteQuery;
  SqliteDatabase(std::string path, sqlite3* connection) : path_(std::move(path)), connection_(connection) {}
  static absl::StatusOr<std::unique_ptr<SqliteDatabase>> Connect(const std::string& path);
  absl::Status Error(int code) const;

  const std::string path_;
  sqlite3* const connection_;
  std::map<std::string, sqlite3_stmt*> statements_;
};

// A statement with its values, ready to run. One at a time of each statement.
class SqliteQuery {
 public:
  ~SqliteQuery();
  SqliteQuery(const SqliteQuery&) = delete;
  SqliteQuery& operator=(const SqliteQuery&) = delete;

  // In the order of the statement's `?`. Strings and blobs must live until the query has run.
  SqliteQuery& Text(absl::string_view value);
  SqliteQuery& Blob(absl::string_view value);
  SqliteQuery& Integer(int64_t value);
  SqliteQuery& Null();

  // For statements without rows.
  absl::Status Run();
  // True: there is a (further) row. False: no more, or an error, which status() has.
  bool Next();
  const absl::Status& status() const { return status_; }

  // Columns of the row, from 0.
  std::string TextAt(int column) const { return BlobAt(column); }
  std::string BlobAt(int column) const;
  int64_t IntegerAt(int column) const { return sqlite3_column_int64(statement_, column); }
  bool IsNullAt(int column) const { return sqlite3_column_type(statement_, column) == SQLITE_NULL; }

 private:
  friend class SqliteDatabase;
  SqliteQuery(SqliteDatabase& database, sqlite3_stmt* statement, absl::Status status)
      : database_(database), statement_(statement), status_(std::move(status)) {}
  void Check(int code);

  SqliteDatabase& database_;
  sqlite3_stmt* const statement_;  // null after an error
  absl::Status status_;
  int bound_ = 0;
};

}  // namespace evpose::server
