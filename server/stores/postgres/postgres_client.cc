// SPDX-License-Identifier: Apache-2.0
#include "server/stores/postgres/postgres_client.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/runtime/out_of_memory.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/commit_guard.h"
#include "server/stores/postgres/postgres_records.h"
#include "server/stores/postgres/postgres_schema.h"

namespace evpose::server {
namespace {

// Other servers can exceed the limit by what they write in this time. Reading the sizes of 100,000 sessions takes some
// tens of milliseconds.
constexpr std::chrono::seconds kReadingPeriod{10};

}  // namespace

PostgresClient::PostgresClient(const PostgresClientOptions& options)
    : options_(options), backoff_(options.first_backoff) {}

absl::StatusOr<std::unique_ptr<PostgresConnection>> PostgresClient::Connect() {
  const std::string name = options_.address.Printable();
  {
    const std::lock_guard lock(mutex_);
    if (std::chrono::steady_clock::now() < next_connection_) {
      return absl::UnavailableError(absl::StrCat(name, " does not respond: tried a moment ago"));
    }
  }
  auto opened = PostgresConnection::Open(options_.address, options_.timeout);
  absl::Status status = opened.status();
  if (status.ok()) status = SetUpPostgresConnection(**opened, name);
  const std::lock_guard lock(mutex_);
  if (status.ok()) {
    backoff_ = options_.first_backoff;
    return opened;
  }
  next_connection_ = std::chrono::steady_clock::now() + absl::ToChronoMilliseconds(backoff_);
  backoff_ = std::min(2 * backoff_, options_.longest_backoff);
  return status;
}

void PostgresClient::Discard(std::unique_ptr<PostgresConnection> connection) {
  std::unique_ptr<PostgresConnection> other;
  {
    const std::lock_guard lock(mutex_);
    // If one connection has failed, the others to the same server probably have, too.
    std::erase_if(idle_, [](const auto& idle) { return !idle->IsAlive(); });
    if (connection->has_timed_out() && !idle_.empty() && !is_closed_) {
      other = std::move(idle_.back());
      idle_.pop_back();
    }
  }
  if (!connection->has_timed_out()) return;
  if (other == nullptr) other = Connect().value_or(nullptr);
  if (other == nullptr) return;
  const bool is_cancelled = other->Run({{.statement = &kPostgresCancel, .values = {connection->process()}}}).ok();
  const std::lock_guard lock(mutex_);
  if (!is_cancelled) idle_.clear();  // the server does not respond on any connection
  if (is_cancelled && !is_closed_) idle_.push_back(std::move(other));
}

absl::Status PostgresClient::With(const std::function<absl::Status(PostgresConnection&)>& work) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<PostgresConnection> connection, Acquire());
  absl::Status status = OrOutOfMemory([&] { return work(*connection); });
  if (IsOutOfMemory(status)) connection.reset();  // results may still arrive
  if (connection != nullptr) connection->RollBack();
  Release(std::move(connection));
  return status;
}

absl::StatusOr<std::vector<PostgresRows>> PostgresClient::Call(const std::vector<PostgresCommand>& commands) {
  std::vector<PostgresRows> rows;
  EVPOSE_RETURN_IF_ERROR(With([&](PostgresConnection& connection) -> absl::Status {
    EVPOSE_ASSIGN_OR_RETURN(rows, connection.Run(commands));
    return absl::OkStatus();
  }));
  return rows;
}

absl::StatusOr<std::unique_ptr<PostgresConnection>> PostgresClient::Acquire() {
  {
    std::unique_lock lock(mutex_);
    released_.wait(
        lock, [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return is_closed_ || num_used_ < options_.max_connections; });
    if (is_closed_) return StoreClosedError();
    ++num_used_;
    while (!idle_.empty()) {
      std::unique_ptr<PostgresConnection> connection = std::move(idle_.back());
      idle_.pop_back();
      // A server that was restarted has closed the connection; then a new one is made.
      if (connection->IsAlive()) return connection;
    }
  }
  auto connected = Connect();
  if (!connected.ok()) Release(nullptr);
  return connected;
}

void PostgresClient::Release(std::unique_ptr<PostgresConnection> connection) {
  if (connection != nullptr && connection->broken()) Discard(std::exchange(connection, nullptr));
  {
    const std::lock_guard lock(mutex_);
    --num_used_;
    if (connection != nullptr && !is_closed_) idle_.push_back(std::move(connection));
  }
  released_.notify_one();
}

absl::Status PostgresClient::MakeRoom(PostgresConnection& connection, uint64_t bytes) {
  const auto now = std::chrono::steady_clock::now();
  {
    const std::lock_guard lock(mutex_);
    if (now < next_reading_ && used_bytes_ + bytes <= options_.max_bytes) {
      used_bytes_ += bytes;
      return absl::OkStatus();
    }
  }
  // More from time to time, because the sessions may be small, and each reading takes some time.
  for (uint64_t num_deleted = 1;; num_deleted = std::min<uint64_t>(2 * num_deleted, 1000)) {
    EVPOSE_ASSIGN_OR_RETURN(const auto rows, connection.Run({{.statement = &kPostgresUsedBytes}}));
    const uint64_t used = rows[0].Unsigned(0, 0);
    std::unique_lock lock(mutex_);
    next_reading_ = now + kReadingPeriod;
    used_bytes_ = used;
    if (used + bytes <= options_.max_bytes) {
      used_bytes_ += bytes;
      return absl::OkStatus();
    }
    lock.unlock();
    std::vector<std::string> names;
    EVPOSE_RETURN_IF_ERROR(DeleteEnded(connection, std::numeric_limits<int64_t>::max(), num_deleted, names));
    if (names.empty()) {
      return absl::ResourceExhaustedError(
          absl::StrCat(options_.address.Printable(), ": the store is full: ", bytes, " bytes do not fit beside ", used,
                       " of at most ", options_.max_bytes, "; delete sessions, or allow more (--store-max-bytes)"));
    }
    NoteDeleted(std::move(names));
  }
}

absl::Status PostgresClient::DeleteEnded(PostgresConnection& connection, int64_t ended_before_ns, uint64_t max_sessions,
                                         std::vector<std::string>& names) {
  EVPOSE_ASSIGN_OR_RETURN(
      const auto rows, connection.Run({{.statement = &kPostgresBegin},
                                       {.statement = &kPostgresLockEnded, .values = {ended_before_ns, max_sessions}}}));
  std::vector<std::string> ended;
  for (size_t row = 0; row < rows[1].size(); ++row) ended.push_back(rows[1].Bytes(row, 0));
  std::vector<PostgresCommand> commands;
  for (const std::string& name : ended) AddPostgresDeletion(name, commands);
  commands.push_back({.statement = &kPostgresCommit});
  EVPOSE_RETURN_IF_ERROR(connection.Run(commands).status());
  std::move(ended.begin(), ended.end(), std::back_inserter(names));
  return absl::OkStatus();
}

void PostgresClient::NoteDeleted(std::vector<std::string> names) {
  const std::lock_guard lock(mutex_);
  std::move(names.begin(), names.end(), std::back_inserter(deleted_));
}

std::vector<std::string> PostgresClient::TakeDeleted() {
  const std::lock_guard lock(mutex_);
  return std::exchange(deleted_, {});
}

void PostgresClient::Close() {
  std::vector<std::unique_ptr<PostgresConnection>> idle;
  {
    const std::lock_guard lock(mutex_);
    is_closed_ = true;
    idle = std::exchange(idle_, {});
  }
  released_.notify_all();
}

}  // namespace evpose::server
