// SPDX-License-Identifier: Apache-2.0

// Whether SQLite's log (the write-ahead log beside the file) was damaged after it was written.
#pragma once

#include <string>

namespace evpose::server {

// What is wrong with the log at `path`, or empty. SQLite itself ends at the first frame that is damaged and says
// nothing, since a crash may leave the last transaction in pieces; but not more than that one, for every transaction is
// on the disk before the next begins. The format: https://www.sqlite.org/fileformat2.html#walformat
std::string FindDamageOfSqliteLog(const std::string& path);

}  // namespace evpose::server
