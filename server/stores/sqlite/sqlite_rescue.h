// SPDX-License-Identifier: Apache-2.0

// Finds the intact records of a store's file and copies them out of a damaged one.
#pragma once

#include <cstdint>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "server/stores/sqlite/sqlite_database.h"
#include "server/stores/sqlite/sqlite_records.h"

namespace evpose::server {

struct SqliteContents {
  // The intact records.
  std::vector<SqliteModelKey> models;
  std::vector<std::string> sessions;
  uint64_t last_fencing_number = 0;  // the highest number found

  // A description of each damage, and the sessions that are damaged.
  std::vector<std::string> damage;
  std::set<std::string, std::less<>> damaged_sessions;
};

// Reads all records. Never fails: a record that cannot be read is listed as damaged.
SqliteContents CheckSqliteContents(SqliteDatabase& database);

// Copies the intact records to a new file, in one transaction. Errors: those of writing `to`, mainly
// RESOURCE_EXHAUSTED.
absl::Status CopySqliteContents(SqliteDatabase& from, const SqliteContents& contents, SqliteDatabase& to);

}  // namespace evpose::server
