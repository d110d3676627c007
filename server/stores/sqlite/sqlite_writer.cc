// SPDX-License-Identifier: Apache-2.0
#include "server/stores/sqlite/sqlite_writer.h"

#include <future>
#include <utility>

#include "core/base/status_macros.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/commit_guard.h"
#include "server/stores/common/job_groups.h"
#include "server/stores/sqlite/sqlite_records.h"

namespace evpose::server {
namespace {

// True for the errors that a write returns before it has changed the database.
bool IsRefusal(const absl::Status& status) {
  return absl::IsAborted(status) || absl::IsNotFound(status) || absl::IsAlreadyExists(status) ||
         absl::IsFailedPrecondition(status) || absl::IsOutOfRange(status);
}

}  // namespace

SqliteWriter::SqliteWriter(std::unique_ptr<SqliteDatabase> database)
    : database_(std::move(database)), thread_([this](std::vector<Job> jobs) { Process(std::move(jobs)); }) {}

void SqliteWriter::Push(Write write, uint64_t size_bytes, SessionLease::Done done) {
  thread_.Push({.write = std::move(write), .size_bytes = size_bytes, .done = std::move(done)});
}

absl::Status SqliteWriter::Call(Write write, uint64_t size_bytes) {
  std::promise<absl::Status> outcome;
  Push(std::move(write), size_bytes, [&outcome](absl::Status status) { outcome.set_value(std::move(status)); });
  return outcome.get_future().get();
}

void SqliteWriter::Close() {
  thread_.Close();
  database_.reset();
}

std::vector<std::string> SqliteWriter::TakeDeletedForRoom() {
  const std::lock_guard lock(mutex_);
  return std::exchange(deleted_for_room_, {});
}

void SqliteWriter::Process(std::vector<Job> jobs) {
  ForEachGroup(
      jobs, [](const Job& job) { return job.size_bytes; }, [this](absl::Span<Job> group) { ProcessGroup(group); });
}

void SqliteWriter::ProcessGroup(absl::Span<Job> group) {
  std::vector<absl::Status> outcomes;
  if (!WriteTogether(group, outcomes)) {
    outcomes.clear();
    for (Job& job : group) outcomes.push_back(WriteAlone(job));
  }
  for (size_t i = 0; i < group.size(); ++i) group[i].done(std::move(outcomes[i]));
}

bool SqliteWriter::WriteTogether(absl::Span<Job> group, std::vector<absl::Status>& outcomes) {
  if (!database_->Execute("BEGIN IMMEDIATE").ok()) return false;
  for (Job& job : group) {
    const int64_t changes_before = database_->total_changes();
    outcomes.push_back(OrUnavailable([&] { return job.write(*database_); }));
    if (outcomes.back().ok()) continue;
    if (!IsRefusal(outcomes.back()) || database_->total_changes() != changes_before) {
      Rollback();
      return false;
    }
  }
  if (database_->Execute("COMMIT").ok()) return true;
  Rollback();
  return false;
}

absl::Status SqliteWriter::WriteAlone(Job& job) {
  absl::Status status = Transact(job.write);
  // Copying the log into the file makes room on the disk if deleted sessions have left free pages in the file.
  if (absl::IsResourceExhausted(status) && database_->Execute("PRAGMA wal_checkpoint(TRUNCATE)").ok()) {
    status = Transact(job.write);
  }
  while (absl::IsResourceExhausted(status) && DeleteOldestEnded()) status = Transact(job.write);
  return status;
}

absl::Status SqliteWriter::Transact(Write& write) {
  EVPOSE_RETURN_IF_ERROR(database_->Execute("BEGIN IMMEDIATE"));
  absl::Status status = OrUnavailable([&] { return write(*database_); });
  if (status.ok()) status = database_->Execute("COMMIT");
  if (!status.ok()) Rollback();
  return status;
}

bool SqliteWriter::DeleteOldestEnded() {
  std::string name;
  Write delete_oldest = [&name](SqliteDatabase& database) -> absl::Status {
    EVPOSE_ASSIGN_OR_RETURN(name, SqliteOldestEndedSession(database));
    return name.empty() ? absl::NotFoundError("no session has ended") : SqliteDeleteSession(database, name);
  };
  if (!Transact(delete_oldest).ok()) return false;
  const std::lock_guard lock(mutex_);
  deleted_for_room_.push_back(std::move(name));
  return true;
}

void SqliteWriter::Rollback() {
  // After some errors, for example a full disk, SQLite has already rolled back.
  if (database_->InTransaction()) (void)database_->Execute("ROLLBACK");
}

}  // namespace evpose::server
