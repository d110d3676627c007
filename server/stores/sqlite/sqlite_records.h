// SPDX-License-Identifier: Apache-2.0

// Models and sessions as rows of tables. The caller opens a transaction where several calls belong together. Errors of
// all functions: those of SqliteDatabase; DATA_LOSS naming a record that does not match its checksum or is missing.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/stores/common/store.h"
#include "server/stores/sqlite/sqlite_database.h"

namespace evpose::server {

// The statements that create the tables of schema version 1, and those that make them the tables of this version. Both
// together create the tables of an empty database.
extern const char* const kSqliteSchemaVersion1;
extern const char* const kSqliteAdditionsToVersion1;
// Makes the tables of schema version 1 those of this version: adds columns and indexes of tenants, requests and writes
// of lifecycles. Damaged records get no tenant. The caller opens the transaction.
absl::Status SqliteUpgradeFromVersion1(SqliteDatabase& database);

// The small mutable values of a session, beside lifecycle, checkpoint and poses.
struct SqliteSessionState {
  uint64_t fencing_number = 0;
  uint64_t next_pose_seq = 1;
  uint64_t first_pose_seq_kept = 1;
  uint32_t checkpoint_checksum = 0;  // 0: no checkpoint yet
  std::optional<int64_t> ended_at_ns;
  std::string holder;        // with fencing_number the token of the lease; empty if an earlier version wrote the state
  uint64_t last_commit = 0;  // number of the last commit of the holder

  FencingToken token() const { return {fencing_number, holder}; }

  static void VisitState(auto& archive, auto& self) {
    auto& [fencing_number, next_pose_seq, first_pose_seq_kept, checkpoint_checksum, ended_at_ns, holder, last_commit] =
        self;
    archive(fencing_number, next_pose_seq, first_pose_seq_kept, checkpoint_checksum, ended_at_ns);
    if constexpr (std::remove_reference_t<decltype(archive)>::kReading) {
      if (archive.remaining() == 0) return;
    }
    archive(holder, last_commit);
  }
};

struct SqliteSession {
  StoredSession stored;
  SqliteSessionState state;
};

// Increments the last fencing number and returns it.
absl::StatusOr<uint64_t> SqliteNextFencingNumber(SqliteDatabase& database);
absl::Status SqliteSetLastFencingNumber(SqliteDatabase& database, uint64_t number);
absl::StatusOr<uint64_t> SqliteLastFencingNumber(SqliteDatabase& database);

// Adds a session without checkpoint and poses. Errors: ALREADY_EXISTS.
absl::Status SqliteInsertSession(SqliteDatabase& database, const SessionRecord& record, absl::string_view lifecycle,
                                 const SqliteSessionState& state);
// Errors: NOT_FOUND.
absl::StatusOr<SqliteSessionState> SqliteReadState(SqliteDatabase& database, absl::string_view session);
absl::Status SqliteWriteState(SqliteDatabase& database, absl::string_view session, const SqliteSessionState& state);
// Writes the parts of the commit and updates `state`, which the caller then writes. Poses from `next_pose_seq` on are
// replaced.
absl::Status SqliteWriteParts(SqliteDatabase& database, absl::string_view session, const SessionCommit& commit,
                              uint64_t next_pose_seq, SqliteSessionState& state);
// Reads a session; segments without a pose after `after_pose_seq` are omitted. Errors: NOT_FOUND.
absl::StatusOr<SqliteSession> SqliteReadSession(SqliteDatabase& database, absl::string_view session,
                                                uint64_t after_pose_seq);
absl::Status SqliteDeleteSession(SqliteDatabase& database, absl::string_view session);
// Errors: NOT_FOUND.
absl::StatusOr<std::string> SqliteReadTenant(SqliteDatabase& database, absl::string_view session);
// Does what Store::ListSessions() describes.
absl::StatusOr<SessionPage> SqliteListSessions(SqliteDatabase& database, absl::string_view tenant,
                                               absl::string_view after_name, size_t max_sessions);
// Errors: NOT_FOUND.
absl::StatusOr<SessionRecord> SqliteFindRequest(SqliteDatabase& database, absl::string_view tenant,
                                                absl::string_view request_id);
// Sorted by name.
absl::StatusOr<std::vector<SessionOwner>> SqliteListOwners(SqliteDatabase& database);
// Does what Store::ReadOldestLifecycles() describes.
absl::StatusOr<std::vector<StoredLifecycle>> SqliteReadOldestLifecycles(SqliteDatabase& database, size_t max_sessions);
// The name of the session with the earliest end; empty when no session has ended.
absl::StatusOr<std::string> SqliteOldestEndedSession(SqliteDatabase& database);
absl::StatusOr<std::vector<std::string>> SqliteSessionsEndedBefore(SqliteDatabase& database, absl::Time time);

// Adds a model, or replaces the tenant's model of this name.
absl::Status SqlitePutModel(SqliteDatabase& database, const ModelRecord& model);
// Errors: NOT_FOUND.
absl::StatusOr<ModelRecord> SqliteReadModel(SqliteDatabase& database, absl::string_view tenant, absl::string_view name);
absl::StatusOr<bool> SqliteHasModel(SqliteDatabase& database, absl::string_view tenant, absl::string_view name);
absl::Status SqliteDeleteModel(SqliteDatabase& database, absl::string_view tenant, absl::string_view name);
struct SqliteModelKey {
  std::string tenant;
  std::string name;
  auto operator<=>(const SqliteModelKey&) const = default;
};
// Sorted by name, then tenant, without `bytes` and `prepared`, and without damaged records.
absl::StatusOr<std::vector<ModelRecord>> SqliteListModels(SqliteDatabase& database);

}  // namespace evpose::server
