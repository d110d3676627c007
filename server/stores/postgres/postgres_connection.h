// SPDX-License-Identifier: Apache-2.0

// A C++ interface to libpq with owned values, limits of each wait, and absl::Status.
#pragma once

#include <libpq-fe.h>

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "server/stores/postgres/postgres_address.h"

namespace evpose::server {

// A value of a statement's parameter: bytes, which the caller keeps until the statement has run, or a number (bigint).
// Values are sent beside the statement and never become a part of it.
class PostgresValue {
 public:
  // NOLINTBEGIN(google-explicit-constructor): a list of values is written as one.
  PostgresValue(absl::string_view bytes) : bytes_(bytes) {}
  PostgresValue(const std::string& bytes) : bytes_(bytes) {}
  PostgresValue(uint64_t number) : PostgresValue(static_cast<int64_t>(number)) {}
  PostgresValue(int64_t number);
  // NOLINTEND(google-explicit-constructor)
  static PostgresValue Null();

  const char* data() const { return is_number_ ? number_ : is_null_ ? nullptr : bytes_.data(); }
  size_t size() const { return is_number_ ? sizeof(number_) : bytes_.size(); }

 private:
  PostgresValue() = default;
  absl::string_view bytes_ = "";
  char number_[8] = {};  // big-endian
  bool is_number_ = false;
  bool is_null_ = false;
};

// A statement that each connection prepares once. Its parameters and results are bytea and bigint in binary form.
struct PostgresStatement {
  const char* name;
  const char* sql;
};

struct PostgresCommand {
  const PostgresStatement* statement = nullptr;
  std::vector<PostgresValue> values;
};

// The rows of a result.
class PostgresRows {
 public:
  explicit PostgresRows(PGresult* result) : result_(result, &PQclear) {}

  size_t size() const { return static_cast<size_t>(PQntuples(result_.get())); }
  bool IsNull(size_t row, int column) const { return PQgetisnull(result_.get(), static_cast<int>(row), column) != 0; }
  std::string Bytes(size_t row, int column) const;
  // 0 for a value that is no bigint.
  int64_t Number(size_t row, int column) const;
  uint64_t Unsigned(size_t row, int column) const { return static_cast<uint64_t>(Number(row, column)); }
  // The tag of the command, for example COMMIT.
  absl::string_view tag() const { return PQcmdStatus(result_.get()); }

 private:
  std::shared_ptr<PGresult> result_;
};

// One connection. After an error of the connection itself (broken()) it cannot be used any more. For one thread at a
// time.
class PostgresConnection {
 public:
  // Connects to the first server of the address that can be written. `timeout` bounds the connection to each server,
  // and later each wait for the next bytes. Errors: UNAVAILABLE; PERMISSION_DENIED for a wrong password or user;
  // FAILED_PRECONDITION if there is no such database. No error contains the password.
  static absl::StatusOr<std::unique_ptr<PostgresConnection>> Open(const PostgresAddress& address,
                                                                  absl::Duration timeout);

  // Sends the commands together and reads one result for each, in order (pipelining). When a command fails, it returns
  // the error, as do all later ones, and a transaction that is open is rolled back. Errors:
  // - UNAVAILABLE: the connection is broken, or the server cannot process the commands at present.
  // - UNAVAILABLE after a warning: PostgreSQL has committed, but has not waited for its synchronous standbys.
  // - RESOURCE_EXHAUSTED: the disk is full. DATA_LOSS: PostgreSQL has found damage. PERMISSION_DENIED. INTERNAL.
  absl::StatusOr<std::vector<PostgresRows>> Run(const std::vector<PostgresCommand>& commands);
  // Runs one or several statements without parameters, separated by semicolons; returns the rows of the last one, in
  // text form. Errors: as Run().
  absl::StatusOr<PostgresRows> Execute(const char* sql);
  // Prepares the statements. To be called once. Errors: as Run().
  absl::Status Prepare(const std::vector<const PostgresStatement*>& statements);

  // Rolls back a transaction that is open. An error shows in broken().
  void RollBack();

  bool broken() const { return is_broken_ || PQstatus(connection_.get()) != CONNECTION_OK; }
  // True if the connection is broken because the server did not respond in time.
  bool has_timed_out() const { return has_timed_out_; }
  // True if the last commands have been committed although PostgreSQL has warned.
  bool has_warned() const { return !warning_.empty(); }
  // Returns whether the connection is usable, as far as can be seen without a wait: a server that has ended or was
  // restarted has closed it.
  bool IsAlive();
  // The number of the server's process for this connection, for pg_cancel_backend().
  int64_t process() const { return PQbackendPID(connection_.get()); }
  // The version of the server: 10,000 times the major number plus the minor number, for example 150004 for 15.4.
  int version() const { return PQserverVersion(connection_.get()); }

 private:
  PostgresConnection(std::string name, PGconn* connection, absl::Duration timeout);
  static void OnNotice(void* self, const PGresult* notice);
  // Waits until PQgetResult() does not block.
  absl::Status Await();
  // Returns the next result, null at the end of those of one command.
  absl::StatusOr<PGresult*> Next();
  // Reads the results of `num_commands` and of the synchronization behind them.
  absl::StatusOr<std::vector<PostgresRows>> Read(size_t num_commands);
  absl::Status MakeError(const PGresult* result) const;
  absl::Status Broken(absl::string_view words);

  const std::string name_;  // for errors
  const std::unique_ptr<PGconn, decltype(&PQfinish)> connection_;
  const absl::Duration timeout_;
  bool is_broken_ = false;
  bool has_timed_out_ = false;
  std::string warning_;  // the first one since the commands were sent
};

}  // namespace evpose::server
