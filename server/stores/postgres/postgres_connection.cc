// SPDX-License-Identifier: Apache-2.0
#include "server/stores/postgres/postgres_connection.h"

#include <poll.h>

#include <algorithm>
#include <cerrno>
#include <system_error>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

constexpr int kBinary = 1;

// Maps a SQLSTATE to the code of a status. Appendix A of PostgreSQL's manual lists them.
absl::StatusCode CodeOf(absl::string_view state) {
  if (state == "53100") return absl::StatusCode::kResourceExhausted;              // disk_full
  if (state == "42501") return absl::StatusCode::kPermissionDenied;               // insufficient_privilege
  if (absl::StartsWith(state, "28")) return absl::StatusCode::kPermissionDenied;  // invalid authorization
  if (state == "XX001" || state == "XX002") return absl::StatusCode::kDataLoss;   // data, index corrupted
  for (const char* const kind : {"08", "40", "53", "55P03", "57", "25006", "25P03", "26000"}) {
    // Connections, deadlocks, exhausted connections or memory, locks, shutdowns and cancelled statements; a server that
    // was made a standby (25006); a transaction that waited too long (25P03); a connection of a pooler without the
    // prepared statements (26000).
    if (absl::StartsWith(state, kind)) return absl::StatusCode::kUnavailable;
  }
  return absl::StatusCode::kInternal;
}

std::string OneLine(absl::string_view words) {
  std::string line(absl::StripAsciiWhitespace(words));
  std::replace(line.begin(), line.end(), '\n', ' ');
  return line;
}

// The server does not send a SQLSTATE that libpq returns for a failed connection, only its words.
absl::Status ConnectionError(const std::string& name, PGconn* connection) {
  const std::string words = OneLine(PQerrorMessage(connection));
  if (PQconnectionNeedsPassword(connection) != 0 || absl::StrContains(words, "authentication failed") ||
      absl::StrContains(words, "pg_hba.conf") || absl::StrContains(words, "no password supplied") ||
      (absl::StrContains(words, "role \"") && absl::StrContains(words, "does not exist")) ||
      absl::StrContains(words, "permission denied for database")) {
    return absl::PermissionDeniedError(absl::StrCat(name, ": ", words, ": check the user and password of --store"));
  }
  if (absl::StrContains(words, "database \"") && absl::StrContains(words, "does not exist")) {
    return absl::FailedPreconditionError(
        absl::StrCat(name, ": ", words, ": create it (createdb), or correct the address of --store"));
  }
  return absl::UnavailableError(absl::StrCat(name, " does not respond: ", words));
}

}  // namespace

PostgresValue::PostgresValue(int64_t number) : is_number_(true) {
  for (size_t i = 0; i < sizeof(number_); ++i) {
    number_[i] = static_cast<char>(static_cast<uint64_t>(number) >> (56 - 8 * i));
  }
}

PostgresValue PostgresValue::Null() {
  PostgresValue value;
  value.is_null_ = true;
  return value;
}

std::string PostgresRows::Bytes(size_t row, int column) const {
  return {PQgetvalue(result_.get(), static_cast<int>(row), column),
          static_cast<size_t>(PQgetlength(result_.get(), static_cast<int>(row), column))};
}

int64_t PostgresRows::Number(size_t row, int column) const {
  if (PQgetlength(result_.get(), static_cast<int>(row), column) != sizeof(uint64_t)) return 0;
  const char* const bytes = PQgetvalue(result_.get(), static_cast<int>(row), column);
  uint64_t number = 0;
  for (size_t i = 0; i < sizeof(number); ++i) number = number << 8 | static_cast<uint8_t>(bytes[i]);
  return static_cast<int64_t>(number);
}

PostgresConnection::PostgresConnection(std::string name, PGconn* connection, absl::Duration timeout)
    : name_(std::move(name)), connection_(connection, &PQfinish), timeout_(timeout) {
  PQsetNoticeReceiver(connection, &OnNotice, this);
}

absl::StatusOr<std::unique_ptr<PostgresConnection>> PostgresConnection::Open(const PostgresAddress& address,
                                                                             absl::Duration timeout) {
  // libpq rejects a limit of less than 2 s.
  const int64_t seconds = std::max<int64_t>(2, absl::ToInt64Seconds(absl::Ceil(timeout, absl::Seconds(1))));
  const std::string connect_timeout = std::to_string(seconds);
  const std::string user_timeout_ms = std::to_string(absl::ToInt64Milliseconds(timeout));
  // Defaults, which parameters of the address override. The keepalives detect that the server's machine has failed.
  std::vector<std::pair<const char*, const char*>> all = {{"connect_timeout", connect_timeout.c_str()},
                                                          {"tcp_user_timeout", user_timeout_ms.c_str()},
                                                          {"keepalives_idle", "5"},
                                                          {"keepalives_interval", "2"},
                                                          {"keepalives_count", "3"},
                                                          {"fallback_application_name", "evpose-server"}};
  for (const auto& [name, value] : address.parameters) all.emplace_back(name.c_str(), value.c_str());
  // Errors of the server are one line of a log in UTF-8.
  all.emplace_back("client_encoding", "UTF8");
  std::vector<const char*> names;
  std::vector<const char*> values;
  for (const auto& [name, value] : all) {
    names.push_back(name);
    values.push_back(value);
  }
  names.push_back(nullptr);
  values.push_back(nullptr);
  PGconn* const opened = PQconnectdbParams(names.data(), values.data(), /*expand_dbname=*/0);
  if (opened == nullptr) return absl::UnavailableError("the server's memory is exhausted");
  std::unique_ptr<PostgresConnection> connection(new PostgresConnection(address.Printable(), opened, timeout));
  if (PQstatus(opened) != CONNECTION_OK) return ConnectionError(connection->name_, opened);
  if (PQsetnonblocking(opened, 1) != 0 || PQenterPipelineMode(opened) != 1) {
    return connection->Broken(PQerrorMessage(opened));
  }
  return connection;
}

void PostgresConnection::OnNotice(void* self, const PGresult* notice) {
  auto* connection = static_cast<PostgresConnection*>(self);
  const char* severity = PQresultErrorField(notice, PG_DIAG_SEVERITY_NONLOCALIZED);
  const char* words = PQresultErrorField(notice, PG_DIAG_MESSAGE_PRIMARY);
  if (severity == nullptr || absl::string_view(severity) != "WARNING" || !connection->warning_.empty()) return;
  connection->warning_ = words == nullptr ? "a warning" : OneLine(words);
}

absl::StatusOr<std::vector<PostgresRows>> PostgresConnection::Run(const std::vector<PostgresCommand>& commands) {
  if (broken()) return Broken("the connection is closed");
  warning_.clear();
  for (const PostgresCommand& command : commands) {
    std::vector<const char*> values;
    std::vector<int> sizes;
    for (const PostgresValue& value : command.values) {
      values.push_back(value.data());
      sizes.push_back(static_cast<int>(value.size()));
    }
    const std::vector<int> formats(values.size(), kBinary);
    if (PQsendQueryPrepared(connection_.get(), command.statement->name, static_cast<int>(values.size()), values.data(),
                            sizes.data(), formats.data(), kBinary) != 1) {
      return Broken(PQerrorMessage(connection_.get()));
    }
  }
  return Read(commands.size());
}

absl::StatusOr<PostgresRows> PostgresConnection::Execute(const char* sql) {
  if (broken()) return Broken("the connection is closed");
  warning_.clear();
  // Several statements in one text are possible outside of the pipeline mode only.
  if (PQexitPipelineMode(connection_.get()) != 1 || PQsendQuery(connection_.get(), sql) != 1) {
    return Broken(PQerrorMessage(connection_.get()));
  }
  PostgresRows last(nullptr);
  absl::Status error;
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(PGresult* const result, Next());
    if (result == nullptr) break;
    const ExecStatusType status = PQresultStatus(result);
    if (error.ok() && status != PGRES_COMMAND_OK && status != PGRES_TUPLES_OK) error = MakeError(result);
    last = PostgresRows(result);
  }
  if (broken()) return error.ok() ? Broken(PQerrorMessage(connection_.get())) : error;
  if (!error.ok()) RollBack();
  if (PQpipelineStatus(connection_.get()) == PQ_PIPELINE_OFF) PQenterPipelineMode(connection_.get());
  if (!error.ok()) return error;
  if (!warning_.empty()) return absl::UnavailableError(absl::StrCat(name_, ": ", warning_));
  return last;
}

void PostgresConnection::RollBack() {
  if (!broken() && PQtransactionStatus(connection_.get()) != PQTRANS_IDLE) (void)Execute("ROLLBACK");
}

absl::Status PostgresConnection::Prepare(const std::vector<const PostgresStatement*>& statements) {
  if (broken()) return Broken("the connection is closed");
  warning_.clear();
  for (const PostgresStatement* const statement : statements) {
    if (PQsendPrepare(connection_.get(), statement->name, statement->sql, 0, nullptr) != 1) {
      return Broken(PQerrorMessage(connection_.get()));
    }
  }
  return Read(statements.size()).status();
}

absl::StatusOr<std::vector<PostgresRows>> PostgresConnection::Read(size_t num_commands) {
  if (PQpipelineSync(connection_.get()) != 1) return Broken(PQerrorMessage(connection_.get()));
  std::vector<PostgresRows> rows;
  absl::Status error;
  size_t num_ended = 0;
  bool is_replaced = false;
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(PGresult* const result, Next());
    if (result == nullptr) {
      // The end of a command. A connection that breaks has no further results.
      if (broken() || ++num_ended > num_commands + 1) return Broken(PQerrorMessage(connection_.get()));
      continue;
    }
    const PostgresRows owned(result);
    const ExecStatusType status = PQresultStatus(result);
    if (status == PGRES_PIPELINE_SYNC) break;
    if (status == PGRES_COMMAND_OK || status == PGRES_TUPLES_OK) {
      rows.push_back(owned);
    } else if (error.ok() && status != PGRES_PIPELINE_ABORTED) {
      error = MakeError(result);
      // The last message of a server that ends the connection is an error of its own. A connection to a server that was
      // made a standby, or without the prepared statements, is not used again.
      const char* const state = PQresultErrorField(result, PG_DIAG_SQLSTATE);
      is_replaced = state != nullptr && (absl::string_view(state) == "25006" || absl::string_view(state) == "26000");
    }
  }
  if (!error.ok()) {
    RollBack();
    is_broken_ |= is_replaced;
    return error;
  }
  if (!warning_.empty()) return absl::UnavailableError(absl::StrCat(name_, ": ", warning_));
  if (rows.size() != num_commands) return Broken("results are missing");
  return rows;
}

absl::StatusOr<PGresult*> PostgresConnection::Next() {
  EVPOSE_RETURN_IF_ERROR(Await());
  return PQgetResult(connection_.get());
}

absl::Status PostgresConnection::Await() {
  while (true) {
    const int unsent = PQflush(connection_.get());
    if (unsent < 0) {
      // What the server has sent before it closed the connection says why.
      (void)PQconsumeInput(connection_.get());
      return Broken(PQerrorMessage(connection_.get()));
    }
    if (PQisBusy(connection_.get()) == 0) return absl::OkStatus();
    pollfd socket = {.fd = PQsocket(connection_.get()), .events = POLLIN, .revents = 0};
    if (socket.fd < 0) return Broken(PQerrorMessage(connection_.get()));
    if (unsent == 1) socket.events |= POLLOUT;
    const int ready = poll(&socket, 1, static_cast<int>(absl::ToInt64Milliseconds(timeout_)));
    if (ready < 0 && errno == EINTR) continue;
    if (ready == 0) {
      has_timed_out_ = true;
      return Broken(absl::StrCat("no response within ", absl::FormatDuration(timeout_)));
    }
    if (ready < 0) return Broken(std::generic_category().message(errno));
    if ((socket.revents & (POLLIN | POLLHUP | POLLERR)) != 0 && PQconsumeInput(connection_.get()) != 1) {
      return Broken(PQerrorMessage(connection_.get()));
    }
  }
}

bool PostgresConnection::IsAlive() {
  if (broken()) return false;
  pollfd socket = {.fd = PQsocket(connection_.get()), .events = POLLIN, .revents = 0};
  if (poll(&socket, 1, 0) <= 0) return true;
  // The server has sent something without being asked: it has closed the connection, or changed a setting.
  if (PQconsumeInput(connection_.get()) != 1) return false;
  (void)PQisBusy(connection_.get());  // reads the messages
  return !broken() && poll(&socket, 1, 0) <= 0;
}

absl::Status PostgresConnection::MakeError(const PGresult* result) const {
  const char* state = PQresultErrorField(result, PG_DIAG_SQLSTATE);
  const char* primary = PQresultErrorField(result, PG_DIAG_MESSAGE_PRIMARY);
  // Not the details, which may contain values of rows.
  const std::string words = OneLine(primary == nullptr ? PQresultErrorMessage(result) : primary);
  // libpq makes an error without SQLSTATE when it has lost the connection.
  const absl::StatusCode code = state == nullptr ? absl::StatusCode::kUnavailable : CodeOf(state);
  const char* remedy = code == absl::StatusCode::kResourceExhausted ? ": make room on PostgreSQL's disk" : "";
  return {code,
          absl::StrCat(name_, ": ", words, state == nullptr ? "" : absl::StrCat(" (SQLSTATE ", state, ")"), remedy)};
}

absl::Status PostgresConnection::Broken(absl::string_view words) {
  is_broken_ = true;
  return absl::UnavailableError(absl::StrCat(name_, " does not respond: ", OneLine(words)));
}

}  // namespace evpose::server
