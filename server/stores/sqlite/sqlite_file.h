// SPDX-License-Identifier: Apache-2.0

// The store's file: made, checked, and when it is damaged, set aside for what of it is whole.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/stores/sqlite/sqlite_database.h"
#include "server/stores/sqlite/sqlite_rescue.h"

namespace evpose::server {

struct SqliteFile {
  std::unique_ptr<SqliteDatabase> database;
  SqliteContents contents;
};

// Opens the file for writing, or makes it, and reads all of it. When anything is damaged, what is whole goes to a new
// file, and the old one is set aside beside it, as PATH.damaged-1 and so on: nothing is ever written to a damaged file.
// Errors: FAILED_PRECONDITION for a file that is no evpose store, or a newer one's; DATA_LOSS for one of which nothing
// can be read; PERMISSION_DENIED; RESOURCE_EXHAUSTED.
absl::StatusOr<SqliteFile> OpenSqliteFile(const std::string& path);

// What would make the file larger fails with RESOURCE_EXHAUSTED. For the writing connection.
absl::Status LimitSqliteBytes(SqliteDatabase& database, uint64_t max_bytes);

// Another connection to the same file, for reading.
absl::StatusOr<std::unique_ptr<SqliteDatabase>> OpenSqliteReader(const std::string& path);

}  // namespace evpose::server
