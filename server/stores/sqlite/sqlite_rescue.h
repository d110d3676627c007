// SPDX-License-Identifier: Apache-2.0

// What of a store's file is whole, and how that is saved from a damaged one.
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
  std::vector<SqliteModelKey> models;
  std::vector<std::string> sessions;
  uint64_t last_fencing_number = 0;

  // One line each, and the sessions and models among it.
  std::vector<std::string> damage;
  std::set<std::string, std::less<>> damaged_sessions;
  std::set<SqliteModelKey> damaged_models;
};

// Reads everything. Never fails: what cannot be read is damaged.
SqliteContents CheckSqliteContents(SqliteDatabase& database);

// Copies what is whole to a new file, in one transaction. Errors: those of `to`, RESOURCE_EXHAUSTED above all.
absl::Status CopySqliteContents(SqliteDatabase& from, const SqliteContents& contents, SqliteDatabase& to);

}  // namespace evpose::server
