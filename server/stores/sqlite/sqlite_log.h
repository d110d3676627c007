// SPDX-License-Identifier: Apache-2.0

// Detects damage of SQLite's write-ahead log, the file beside the database.
#pragma once

#include <string>

namespace evpose::server {

// Returns a description of the damage of the log at `path`, or empty. SQLite stops at the first damaged frame without
// an error, because a crash may leave the last transaction incomplete. Only the last one, however: every transaction is
// on the disk before the next begins, so more than one lost transaction means damage. The format:
// https://www.sqlite.org/fileformat2.html#walformat
std::string FindDamageOfSqliteLog(const std::string& path);

}  // namespace evpose::server
