// SPDX-License-Identifier: Apache-2.0

// The one thread that writes to the store's file.
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

// What waits is written in one transaction: a hundred sessions cost one wait for the disk. What fails there is tried
// again on its own, so that it fails for nobody else. Thread-safe. Outlives its store, closed.
class SqliteWriter {
 public:
  // Inside a transaction, perhaps several times until one succeeds. An error undoes it.
  using Write = absl::AnyInvocable<absl::Status(SqliteDatabase&)>;

  explicit SqliteWriter(std::unique_ptr<SqliteDatabase> database);

  // `done` as SessionLease has it. `size_bytes`: about what is written.
  void Push(Write write, uint64_t size_bytes, SessionLease::Done done);
  // Waits; not from a thread of the store. Errors: CANCELLED, beside those of `write` and of the disk.
  absl::Status Call(Write write, uint64_t size_bytes = 0);

  // What waits is written, and the file closed. Once.
  void Close();

  // The names of sessions that had to go for room, since the last call.
  std::vector<std::string> TakeDeletedForRoom();

 private:
  struct Job {
    Write write;
    uint64_t size_bytes = 0;
    SessionLease::Done done;
  };

  void Process(std::vector<Job> jobs);
  void ProcessGroup(absl::Span<Job> group);
  // False: nothing of it was written.
  bool WriteTogether(absl::Span<Job> group, std::vector<absl::Status>& outcomes);
  absl::Status WriteAlone(Job& job);
  absl::Status Transact(Write& write);
  bool DeleteOldestEnded();
  void Rollback();

  std::unique_ptr<SqliteDatabase> database_;  // of the thread, until it is closed
  std::mutex mutex_;
  std::vector<std::string> deleted_for_room_ ABSL_GUARDED_BY(mutex_);
  JobThread<Job> thread_;  // last: it uses what stands above
};

}  // namespace evpose::server
