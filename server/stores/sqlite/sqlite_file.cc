// SPDX-License-Identifier: Apache-2.0
#include "server/stores/sqlite/sqlite_file.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <system_error>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/stores/sqlite/data_directory.h"
#include "server/stores/sqlite/sqlite_log.h"
#include "server/stores/sqlite/sqlite_records.h"

namespace evpose::server {
namespace {

constexpr int64_t kApplicationId = 0x4556504F;  // "EVPO", in the file's header
constexpr int64_t kSchemaVersion = 2;
constexpr uint64_t kMaxPages = 4294967294;  // SQLite's own limit
constexpr absl::string_view kFileMagic("SQLite format 3\0", 16);

// Pages are larger than SQLite's default of 4096 bytes, because checkpoints have megabytes.
const char* const kNewFileSettings = "PRAGMA page_size=16384; PRAGMA journal_mode=WAL";
// synchronous=FULL: a commit is on the disk when it is complete. LimitSqliteBytes() replaces the limits of the log.
const char* const kWriterSettings =
    "PRAGMA synchronous=FULL; PRAGMA wal_autocheckpoint=4096; PRAGMA journal_size_limit=134217728; "
    "PRAGMA cache_size=-16384";
// The write-ahead log grows to kMaxLogPages pages (64 MB), or in a smaller store to 1 / kLogShare of its pages, before
// it is copied into the file, so that checkpoints which are replaced soon are not copied. The log file is not truncated
// below twice that size, so that sessions can be deleted also when the disk is full.
constexpr uint64_t kMaxLogPages = 4096;
constexpr uint64_t kLogShare = 16;

uint64_t SizeBytes(const std::string& path) {
  std::error_code error;
  const uintmax_t size = std::filesystem::file_size(path, error);
  return error ? 0 : size;
}

// Rejects a file that is not a SQLite database, with advice that SQLite's own error does not have. A beginning of the
// magic string is accepted, because a truncated store may be repaired.
absl::Status CheckMagic(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return absl::PermissionDeniedError(absl::StrCat(path, ": the server's user cannot read it"));
  std::string magic(kFileMagic.size(), '\0');
  file.read(magic.data(), static_cast<std::streamsize>(magic.size()));
  magic.resize(static_cast<size_t>(file.gcount()));
  if (absl::StartsWith(kFileMagic, magic)) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(path, " is no SQLite database: move it away, or choose another --data-dir"));
}

absl::StatusOr<int64_t> ReadPragma(SqliteDatabase& database, const std::string& name) {
  SqliteQuery query = database.Query("PRAGMA " + name);
  const bool found = query.Next();
  EVPOSE_RETURN_IF_ERROR(query.status());
  return found ? query.IntegerAt(0) : 0;
}

// Creates the tables in one transaction, so that a crash leaves an empty database.
absl::Status MakeTables(SqliteDatabase& database) {
  EVPOSE_RETURN_IF_ERROR(database.Execute(kNewFileSettings));
  EVPOSE_RETURN_IF_ERROR(database.Execute(kWriterSettings));
  return database.Execute(absl::StrCat("BEGIN IMMEDIATE;", kSqliteSchemaVersion1, kSqliteAdditionsToVersion1,
                                       "PRAGMA application_id=", kApplicationId,
                                       "; PRAGMA user_version=", kSchemaVersion, "; COMMIT"));
}

absl::StatusOr<std::unique_ptr<SqliteDatabase>> MakeFile(const std::string& path) {
  EVPOSE_RETURN_IF_ERROR(MakePrivateFile(path));
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<SqliteDatabase> database, SqliteDatabase::Open(path));
  EVPOSE_RETURN_IF_ERROR(MakeTables(*database));
  return database;
}

// Upgrades the file in one transaction, so that a crash leaves the earlier version.
absl::Status Upgrade(SqliteDatabase& database) {
  absl::Status status = database.Execute("BEGIN IMMEDIATE");
  if (status.ok()) status = SqliteUpgradeFromVersion1(database);
  if (status.ok()) status = database.Execute(absl::StrCat("PRAGMA user_version=", kSchemaVersion, "; COMMIT"));
  if (!absl::IsResourceExhausted(status)) return status;
  return absl::ResourceExhaustedError(absl::StrCat(status.message(), ", because the file is upgraded to schema ",
                                                   kSchemaVersion, "; or run the earlier version of evpose"));
}

absl::Status CheckVersion(SqliteDatabase& database) {
  EVPOSE_ASSIGN_OR_RETURN(const int64_t application, ReadPragma(database, "application_id"));
  EVPOSE_ASSIGN_OR_RETURN(const int64_t version, ReadPragma(database, "user_version"));
  EVPOSE_ASSIGN_OR_RETURN(const int64_t schema_changes, ReadPragma(database, "schema_version"));
  if (application == 0 && version == 0 && schema_changes == 0) return MakeTables(database);
  if (application != kApplicationId) {
    return absl::FailedPreconditionError(
        absl::StrCat(database.path(), " is another program's database: move it away, or choose another --data-dir"));
  }
  if (version > kSchemaVersion) {
    return absl::FailedPreconditionError(absl::StrCat(database.path(), " was written by a newer evpose (schema ",
                                                      version, "; this one supports ", kSchemaVersion,
                                                      "): run that version, or choose another --data-dir"));
  }
  EVPOSE_RETURN_IF_ERROR(database.Execute(kWriterSettings));
  return version == kSchemaVersion ? absl::OkStatus() : Upgrade(database);
}

// The new name of a damaged file: the first free number.
std::string SetAsidePath(const std::string& path) {
  int number = 1;
  while (access(absl::StrCat(path, ".damaged-", number).c_str(), F_OK) == 0) ++number;
  return absl::StrCat(path, ".damaged-", number);
}

// Renames the damaged file to `set_aside` and the rescued one to `path`. The last rename replaces `path` atomically.
// The log of the damaged file is moved before, because SQLite would apply it to the new file.
absl::Status Exchange(const std::string& rescued, const std::string& path, const std::string& set_aside) {
  const auto failed = [&] {
    return absl::PermissionDeniedError(
        absl::StrCat(path, ": cannot be set aside as ", set_aside, ": ", std::generic_category().message(errno)));
  };
  if (link(path.c_str(), set_aside.c_str()) != 0) return failed();
  const std::string log = path + "-wal";
  if (rename(log.c_str(), (set_aside + "-wal").c_str()) != 0 && errno != ENOENT) return failed();
  if (unlink((path + "-shm").c_str()) != 0 && errno != ENOENT) return failed();
  if (rename(rescued.c_str(), path.c_str()) != 0) return failed();
  return absl::OkStatus();
}

absl::StatusOr<SqliteFile> Rescue(const std::string& path) {
  const std::string rescued_path = path + ".rescued";
  const std::string set_aside = SetAsidePath(path);
  for (const char* const suffix : {"", "-wal", "-shm"}) unlink((rescued_path + suffix).c_str());
  SqliteFile file;
  {
    EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<SqliteDatabase> damaged, SqliteDatabase::OpenDamaged(path));
    file.contents = CheckSqliteContents(*damaged);
    EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<SqliteDatabase> rescued, MakeFile(rescued_path));
    EVPOSE_RETURN_IF_ERROR(CopySqliteContents(*damaged, file.contents, *rescued));
    // Copies the log into the file, so that a single rename moves everything.
    EVPOSE_RETURN_IF_ERROR(rescued->Execute("PRAGMA wal_checkpoint(TRUNCATE)"));
  }
  EVPOSE_RETURN_IF_ERROR(Exchange(rescued_path, path, set_aside));
  file.contents.damage.push_back(absl::StrCat("the intact records of ", path, ": ", file.contents.sessions.size(),
                                              " sessions and ", file.contents.models.size(),
                                              " models, are in a new file; the damaged one is ", set_aside));
  EVPOSE_ASSIGN_OR_RETURN(file.database, SqliteDatabase::Open(path));
  EVPOSE_RETURN_IF_ERROR(file.database->Execute(kWriterSettings));
  return file;
}

std::string MarkOf(const std::string& path) { return path + ".check"; }

absl::StatusOr<SqliteFile> OpenOrRescue(const std::string& path, bool must_check) {
  SqliteFile file;
  {
    EVPOSE_ASSIGN_OR_RETURN(file.database, SqliteDatabase::Open(path));
    const absl::Status version = CheckVersion(*file.database);
    if (!version.ok() && !absl::IsDataLoss(version)) return version;
    if (version.ok() && must_check) file.contents = CheckSqliteContents(*file.database);
    if (version.ok() && file.contents.damage.empty()) return file;
  }
  file.database.reset();
  return Rescue(path);
}

}  // namespace

void MarkForCheck(const std::string& path) { (void)MakePrivateFile(MarkOf(path)); }

absl::StatusOr<SqliteFile> OpenSqliteFile(const std::string& path, uint64_t max_checked_bytes) {
  SqliteFile file;
  if (SizeBytes(path) == 0 && SizeBytes(path + "-wal") == 0) {
    EVPOSE_ASSIGN_OR_RETURN(file.database, MakeFile(path));
    return file;
  }
  // SQLite would delete the log of an empty file, and the sessions in it.
  if (SizeBytes(path) == 0) {
    EVPOSE_RETURN_IF_ERROR(MakePrivateFile(path));
    return Rescue(path);
  }
  EVPOSE_RETURN_IF_ERROR(CheckMagic(path));
  const std::string damage_of_log = FindDamageOfSqliteLog(path + "-wal");
  const bool must_check = SizeBytes(path) <= max_checked_bytes || access(MarkOf(path).c_str(), F_OK) == 0;
  EVPOSE_ASSIGN_OR_RETURN(file, OpenOrRescue(path, must_check));
  unlink(MarkOf(path).c_str());
  if (!damage_of_log.empty()) file.contents.damage.push_back(damage_of_log);
  return file;
}
absl::Status LimitSqliteBytes(SqliteDatabase& database, uint64_t max_bytes) {
  EVPOSE_ASSIGN_OR_RETURN(const int64_t page_size, ReadPragma(database, "page_size"));
  const auto page_bytes = static_cast<uint64_t>(page_size);
  const uint64_t max_pages = max_bytes / page_bytes;
  const uint64_t log_pages = std::clamp<uint64_t>(max_pages / kLogShare, 1, kMaxLogPages);
  const uint64_t file_pages = std::clamp<uint64_t>(max_pages - std::min(2 * log_pages, max_pages), 1, kMaxPages);
  return database.Execute(absl::StrCat("PRAGMA max_page_count=", file_pages, "; PRAGMA wal_autocheckpoint=", log_pages,
                                       "; PRAGMA journal_size_limit=", 2 * log_pages * page_bytes));
}

absl::StatusOr<uint64_t> SqliteUsedBytes(SqliteDatabase& database) {
  SqliteQuery query = database.Query(
      "SELECT (page_count - freelist_count) * page_size FROM pragma_page_count, pragma_freelist_count, "
      "pragma_page_size");
  const bool found = query.Next();
  EVPOSE_RETURN_IF_ERROR(query.status());
  return (found ? static_cast<uint64_t>(query.IntegerAt(0)) : 0) + SizeBytes(database.path() + "-wal");
}

absl::StatusOr<std::unique_ptr<SqliteDatabase>> OpenSqliteReader(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<SqliteDatabase> database, SqliteDatabase::Open(path));
  EVPOSE_RETURN_IF_ERROR(database->Execute("PRAGMA query_only=ON"));
  return database;
}

}  // namespace evpose::server
