// SPDX-License-Identifier: Apache-2.0

// The thread that writes the commits of sessions.
#pragma once

#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "server/stores/common/job_thread.h"
#include "server/stores/common/store.h"
#include "server/stores/postgres/postgres_client.h"
#include "server/stores/postgres/postgres_records.h"

namespace evpose::server {

// Combines all waiting commits in one transaction with two round trips, so that a hundred sessions cost one wait for
// the disk and for the standby. When a transaction fails, its commits are repeated one by one, so that one failing
// commit does not affect the others. Thread-safe. Leases may hold the writer after its store has closed it.
class PostgresWriter {
 public:
  explicit PostgresWriter(std::shared_ptr<PostgresClient> client);

  // Queues a commit. `done`: see SessionLease::Done. It is OK only after COMMIT has returned, with the standbys that
  // PostgreSQL waits for.
  void Push(PostgresCommit commit, SessionLease::Done done);
  // Calls `done` with `status` from the thread of the writer.
  void Refuse(absl::Status status, SessionLease::Done done);

  // Processes the waiting commits and closes the connection. To be called once.
  void Close();

 private:
  struct Job {
    std::unique_ptr<const PostgresCommit> commit;  // null: only `refusal` is reported
    absl::Status refusal;
    SessionLease::Done done;
  };
  using Outcomes = std::vector<absl::Status>;

  void Process(std::vector<Job> jobs);
  void ProcessGroup(absl::Span<Job> group);
  absl::Status Connect();
  // Writes a group in one transaction. After an error, `is_unknown` is false if none of its commits was written: they
  // can then be repeated one by one. It is true if they may have been written, or there is no connection.
  absl::Status WriteTogether(absl::Span<Job> group, Outcomes& outcomes, bool& is_unknown);
  absl::Status Transact(absl::Span<Job> group, Outcomes& outcomes);

  const std::shared_ptr<PostgresClient> client_;
  std::unique_ptr<PostgresConnection> connection_;  // used by the thread only, until Close()
  JobThread<Job> thread_;                           // the last member, because it uses the others
};

}  // namespace evpose::server
