// SPDX-License-Identifier: Apache-2.0

// Models and sessions as rows. Who calls holds a transaction where several calls belong together. Errors of all: those
// of SqliteDatabase; DATA_LOSS naming what does not match its checksum, or is missing beside the rest.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/stores/common/store.h"
#include "server/stores/sqlite/sqlite_database.h"

namespace evpose::server {

// The statements that make the tables of an empty database.
extern const char* const kSqliteSchema;

// What changes about a session, beside its bytes.
struct SqliteSessionState {
  uint64_t fencing_number = 0;
  uint64_t next_pose_seq = 1;
  uint64_t first_pose_seq_kept = 1;
  uint32_t checkpoint_seal = 0;  // 0: no checkpoint yet
  std::optional<int64_t> ended_at_ns;

  static void VisitState(auto& archive, auto& self) {
    auto& [fencing_number, next_pose_seq, first_pose_seq_kept, checkpoint_seal, ended_at_ns] = self;
    archive(fencing_number, next_pose_seq, first_pose_seq_kept, checkpoint_seal, ended_at_ns);
  }
};

struct SqliteSession {
  StoredSession stored;
  SqliteSessionState state;
};

// A number above all that were given before.
absl::StatusOr<uint64_t> SqliteNextFencingNumber(SqliteDatabase& database);
absl::Status SqliteSetLastFencingNumber(SqliteDatabase& database, uint64_t number);
absl::StatusOr<uint64_t> SqliteLastFencingNumber(SqliteDatabase& database);

// Errors: ALREADY_EXISTS.
absl::Status SqliteInsertSession(SqliteDatabase& database, const SessionRecord& record, absl::string_view lifecycle,
                                 const SqliteSessionState& state);
// Errors: NOT_FOUND.
absl::StatusOr<SqliteSessionState> SqliteReadState(SqliteDatabase& database, absl::string_view session);
absl::Status SqliteWriteState(SqliteDatabase& database, absl::string_view session, const SqliteSessionState& state);
// Writes the parts that the commit has, and changes `state` as they say. Poses from `next_pose_seq` on are replaced.
absl::Status SqliteWriteParts(SqliteDatabase& database, absl::string_view session, const SessionCommit& commit,
                              uint64_t next_pose_seq, SqliteSessionState& state);
// Without the segments that have no pose after this one. Errors: NOT_FOUND.
absl::StatusOr<SqliteSession> SqliteReadSession(SqliteDatabase& database, absl::string_view session,
                                                uint64_t after_pose_seq);
absl::Status SqliteDeleteSession(SqliteDatabase& database, absl::string_view session);
// In their order.
absl::StatusOr<std::vector<SessionRecord>> SqliteListSessions(SqliteDatabase& database);
// In the order of their names.
absl::StatusOr<std::vector<StoredLifecycle>> SqliteReadLifecycles(SqliteDatabase& database);
// The one that ended first; empty when none has.
absl::StatusOr<std::string> SqliteOldestEndedSession(SqliteDatabase& database);
absl::StatusOr<std::vector<std::string>> SqliteSessionsEndedBefore(SqliteDatabase& database, absl::Time time);

// Putting a name of a tenant again changes nothing.
absl::Status SqlitePutModel(SqliteDatabase& database, const ModelRecord& model);
// Errors: NOT_FOUND.
absl::StatusOr<ModelRecord> SqliteReadModel(SqliteDatabase& database, absl::string_view tenant, absl::string_view name);
absl::Status SqliteDeleteModel(SqliteDatabase& database, absl::string_view tenant, absl::string_view name);
struct SqliteModelKey {
  std::string tenant;
  std::string name;
  auto operator<=>(const SqliteModelKey&) const = default;
};
// In the order of names, then tenants.
absl::StatusOr<std::vector<SqliteModelKey>> SqliteListModels(SqliteDatabase& database);

}  // namespace evpose::server
