// SPDX-License-Identifier: Apache-2.0

// The thread that writes to the store's file.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/functional/any_invocable.h"
#include "absl/status/status.h"
#include "server/stores/common/job_thread.h"
#include "server/stores/common/store.h"
#include "server/stores/sqlite/sqlite_database.h"

namespace evpose::server {

// Combines all waiting writes in one transaction, so that a hundred sessions cost one fsync. When a transaction fails,
// its writes are repeated one by one, so that one failing write does not affect the others. Thread-safe. Leases may
// hold the writer after its store has closed it.
class SqliteWriter {
 public:
  // Runs inside a transaction, possibly several times until one succeeds. An error rolls the transaction back.
  using Write = absl::AnyInvocable<absl::Status(SqliteDatabase&)>;

  explicit SqliteWriter(std::unique_ptr<SqliteDatabase> database);

  // Queues a write. `done`: see SessionLease::Done. `size_bytes`: approximate number of bytes written.
  void Push(Write write, uint64_t size_bytes, SessionLease::Done done);
  // Does the same as Push(), and waits for the outcome. Not to be called from a thread of the store. Errors: CANCELLED
  // when the writer is closed; those of `write` and of the transaction.
  absl::Status Call(Write write, uint64_t size_bytes = 0);

  // Processes the waiting writes and closes the file. To be called once.
  void Close();

  // Returns the names of the sessions that were deleted since the last call because the file was full.
  std::vector<std::string> TakeDeletedForRoom();

 private:
  struct Job {
    Write write;
    uint64_t size_bytes = 0;
    SessionLease::Done done;
  };

  void Process(std::vector<Job> jobs);
  void ProcessGroup(absl::Span<Job> group);
  // Writes the group in one transaction. False: the transaction failed and nothing was written.
  bool WriteTogether(absl::Span<Job> group, std::vector<absl::Status>& outcomes);
  absl::Status WriteAlone(Job& job);
  absl::Status Transact(Write& write);
  bool DeleteOldestEnded();
  void Rollback();

  std::unique_ptr<SqliteDatabase> database_;  // used by the thread only, until Close()
  std::mutex mutex_;
  std::vector<std::string> deleted_for_room_ ABSL_GUARDED_BY(mutex_);
  JobThread<Job> thread_;  // the last member, because it uses the others
};

}  // namespace evpose::server
