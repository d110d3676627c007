// SPDX-License-Identifier: Apache-2.0

// Opening the file of the store: creates it, checks it, and rescues the intact records of a damaged one.
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

// Opens the file for writing, or creates it, and checks all records if it is not larger than `max_checked_bytes` or was
// marked with MarkForCheck(). When a record is damaged, the intact ones are copied to a new file, and the damaged file
// is renamed to PATH.damaged-1, -2 and so on; a damaged file is never written to. Errors: FAILED_PRECONDITION for a
// file that is not a store of evpose or was written by a newer version; DATA_LOSS when nothing can be read;
// PERMISSION_DENIED; RESOURCE_EXHAUSTED.
absl::StatusOr<SqliteFile> OpenSqliteFile(const std::string& path, uint64_t max_checked_bytes);
// Has the file checked when it is opened again, because a damaged record was read. Does nothing if the disk is full.
void MarkForCheck(const std::string& path);

// Limits the size of the file and its log together: writes beyond it fail with RESOURCE_EXHAUSTED. A single transaction
// may make the log longer until it has been copied into the file. For the writing connection.
absl::Status LimitSqliteBytes(SqliteDatabase& database, uint64_t max_bytes);

// Returns the bytes of the file that are in use, and those of its log.
absl::StatusOr<uint64_t> SqliteUsedBytes(SqliteDatabase& database);

// Opens another connection to the same file, for reading only.
absl::StatusOr<std::unique_ptr<SqliteDatabase>> OpenSqliteReader(const std::string& path);

}  // namespace evpose::server
