// SPDX-License-Identifier: Apache-2.0

// The connections of a store to PostgreSQL.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/stores/postgres/postgres_address.h"
#include "server/stores/postgres/postgres_connection.h"

namespace evpose::server {

struct PostgresClientOptions {
  PostgresAddress address;
  // The limit of each wait: for a connection to one of the servers, and for the next bytes of a result. A commit waits
  // that long for synchronous standbys.
  absl::Duration timeout = absl::Seconds(5);
  // After a failed connection no new one is tried for this time, doubled for each further failure up to
  // `longest_backoff`. Calls in the meantime fail immediately. A short interruption costs little with the first; with
  // the last a server that returns is noticed after one second.
  absl::Duration first_backoff = absl::Milliseconds(50);
  absl::Duration longest_backoff = absl::Seconds(1);
  // Connections for calls, beside that of the writer. PostgreSQL has a process for each, and by default 100 in all.
  size_t max_connections = 4;
  // Limit of the bytes of all sessions and models. PostgreSQL itself has none.
  uint64_t max_bytes = UINT64_MAX;
};

// Makes connections, keeps some for calls, and bounds the bytes in the tables. Thread-safe.
class PostgresClient {
 public:
  explicit PostgresClient(const PostgresClientOptions& options);

  // Opens a connection and prepares its statements. Errors: those of PostgresConnection::Open() and of
  // SetUpPostgresConnection(); UNAVAILABLE immediately after a failure.
  absl::StatusOr<std::unique_ptr<PostgresConnection>> Connect();
  // Closes a connection. If it has timed out, PostgreSQL is asked to cancel what it executes for it, such as the wait
  // for a standby, which it would continue for a client that has left.
  void Discard(std::unique_ptr<PostgresConnection> connection);

  // Runs `work` on a connection that no other thread uses. A transaction that it leaves open is rolled back. Errors:
  // those of Connect() and of `work`; CANCELLED after Close().
  absl::Status With(const std::function<absl::Status(PostgresConnection&)>& work);
  // Runs commands on such a connection, all in one transaction. Errors: those of PostgresConnection::Run().
  absl::StatusOr<std::vector<PostgresRows>> Call(const std::vector<PostgresCommand>& commands);

  // Makes room for bytes that are about to be written: deletes ended sessions, beginning with the earliest end, while
  // the limit would be exceeded. The connection has no open transaction. The sizes are read again when the limit is
  // near, and at times, because other servers write, too. Errors: RESOURCE_EXHAUSTED; those of PostgresConnection.
  absl::Status MakeRoom(PostgresConnection& connection, uint64_t bytes);
  // Deletes up to `max_sessions` sessions that ended before a time, beginning with the earliest end, and appends their
  // names. Errors: those of PostgresConnection.
  static absl::Status DeleteEnded(PostgresConnection& connection, int64_t ended_before_ns, uint64_t max_sessions,
                                  std::vector<std::string>& names);
  // Keeps the names of deleted sessions. MakeRoom() does so itself.
  void NoteDeleted(std::vector<std::string> names);
  // Returns the names that were kept since the last call.
  std::vector<std::string> TakeDeleted();

  // Closes the connections for calls. To be called once, when no call is in progress.
  void Close();

  const PostgresClientOptions& options() const { return options_; }

 private:
  absl::StatusOr<std::unique_ptr<PostgresConnection>> Acquire();
  void Release(std::unique_ptr<PostgresConnection> connection);

  const PostgresClientOptions options_;
  std::mutex mutex_;
  std::condition_variable released_;
  std::vector<std::unique_ptr<PostgresConnection>> idle_ ABSL_GUARDED_BY(mutex_);
  size_t num_used_ ABSL_GUARDED_BY(mutex_) = 0;
  bool is_closed_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Duration backoff_ ABSL_GUARDED_BY(mutex_);
  std::chrono::steady_clock::time_point next_connection_ ABSL_GUARDED_BY(mutex_);
  uint64_t used_bytes_ ABSL_GUARDED_BY(mutex_) = 0;  // when they were read, and what was written since then
  std::chrono::steady_clock::time_point next_reading_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::string> deleted_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
