// SPDX-License-Identifier: Apache-2.0

// A C++ interface to SQLite with owned values and absl::Status.
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

// One connection with its prepared statements. For one thread at a time.
class SqliteDatabase {
 public:
  // Opens the file, or creates it. Errors name the path.
  static absl::StatusOr<std::unique_ptr<SqliteDatabase>> Open(const std::string& path);
  // Opens a damaged file for reading, so that intact records can be copied.
  static absl::StatusOr<std::unique_ptr<SqliteDatabase>> OpenDamaged(const std::string& path);
  ~SqliteDatabase();
  SqliteDatabase(const SqliteDatabase&) = delete;
  SqliteDatabase& operator=(const SqliteDatabase&) = delete;

  const std::string& path() const { return path_; }

  // Executes one or more statements without parameters. Errors: RESOURCE_EXHAUSTED for a full disk or quota, DATA_LOSS
  // for a damaged file, UNAVAILABLE while another process locks it, PERMISSION_DENIED, INTERNAL. The message has the
  // path, SQLite's text, and advice.
  absl::Status Execute(const std::string& sql);
  // Returns a query with parameters. The statement is prepared once and cached. Errors are returned when the query
  // runs.
  SqliteQuery Query(const std::string& sql);

  bool InTransaction() const { return sqlite3_get_autocommit(connection_) == 0; }
  // The number of rows that this connection has changed.
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

// A prepared statement with its parameters. At most one query of each statement may exist at a time.
class SqliteQuery {
 public:
  ~SqliteQuery();
  SqliteQuery(const SqliteQuery&) = delete;
  SqliteQuery& operator=(const SqliteQuery&) = delete;

  // Bind the next parameter, in the order of the statement's `?`. Strings and blobs must live until the query has run.
  SqliteQuery& Text(absl::string_view value);
  SqliteQuery& Blob(absl::string_view value);
  SqliteQuery& Integer(int64_t value);
  SqliteQuery& Null();

  // Runs a statement to its end and ignores its rows.
  absl::Status Run();
  // Advances to the first or next row. False: there is no further row, or an error occurred, which status() returns.
  bool Next();
  const absl::Status& status() const { return status_; }

  // Read a column of the current row, numbered from 0.
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
