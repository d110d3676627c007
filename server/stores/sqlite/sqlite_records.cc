// SPDX-License-Identifier: Apache-2.0
#include "server/stores/sqlite/sqlite_records.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "core/base/state_io.h"
#include "core/base/status_macros.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/checked_records.h"

namespace evpose::server {

// Every blob has a checksum (checked_records.h). `ended_at_ns` is a copy of the value in the state, for the index.
const char* const kSqliteSchemaVersion1 = R"sql(
CREATE TABLE fencing (last INTEGER NOT NULL);
INSERT INTO fencing VALUES (0);
CREATE TABLE models (name TEXT NOT NULL, tenant TEXT NOT NULL, header BLOB NOT NULL, bytes BLOB NOT NULL,
  PRIMARY KEY (name, tenant));
CREATE TABLE sessions (name TEXT NOT NULL PRIMARY KEY, ended_at_ns INTEGER, state BLOB NOT NULL, record BLOB NOT NULL,
  lifecycle BLOB NOT NULL);
CREATE INDEX sessions_ended ON sessions (ended_at_ns) WHERE ended_at_ns IS NOT NULL;
CREATE TABLE checkpoints (session TEXT NOT NULL PRIMARY KEY, bytes BLOB NOT NULL);
CREATE TABLE poses (session TEXT NOT NULL, first_pose_seq INTEGER NOT NULL, last_pose_seq INTEGER NOT NULL,
  bytes BLOB NOT NULL, PRIMARY KEY (session, first_pose_seq));
)sql";

// For the indexes, `tenant` and `request_id` are copies of those in the record. `lifecycle_write` is the number of the
// latest write of the lifecycle, over all sessions.
const char* const kSqliteAdditionsToVersion1 = R"sql(
ALTER TABLE sessions ADD COLUMN tenant TEXT NOT NULL DEFAULT '';
ALTER TABLE sessions ADD COLUMN request_id TEXT NOT NULL DEFAULT '';
ALTER TABLE sessions ADD COLUMN lifecycle_write INTEGER NOT NULL DEFAULT 0;
CREATE INDEX sessions_of_tenant ON sessions (tenant, name);
CREATE INDEX sessions_of_request ON sessions (tenant, request_id) WHERE request_id <> '';
CREATE INDEX sessions_by_lifecycle_write ON sessions (lifecycle_write);
)sql";

namespace {

std::string StateOf(absl::string_view session) { return absl::StrCat("the state of ", session); }

std::string EncodeState(absl::string_view session, const SqliteSessionState& state) {
  StateWriter writer;
  writer(state);
  return AddChecksum(StateOf(session), writer.Take());
}

absl::StatusOr<SqliteSessionState> DecodeState(absl::string_view session, std::string encoded) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string bytes, VerifyChecksum(StateOf(session), std::move(encoded)));
  SqliteSessionState state;
  StateReader reader(bytes);
  reader(state);
  EVPOSE_RETURN_IF_ERROR(reader.Finish());
  return state;
}

SqliteQuery& BindEnd(SqliteQuery& query, const std::optional<int64_t>& ended_at_ns) {
  return ended_at_ns.has_value() ? query.Integer(*ended_at_ns) : query.Null();
}

absl::Status WriteCheckpoint(SqliteDatabase& database, absl::string_view session, const std::string& checkpoint,
                             SqliteSessionState& state) {
  const std::string encoded = AddChecksum(CheckpointOf(session), checkpoint);
  state.checkpoint_checksum = ChecksumOf(encoded);
  return database
      .Query("INSERT INTO checkpoints VALUES (?, ?) ON CONFLICT (session) DO UPDATE SET bytes = excluded.bytes")
      .Text(session)
      .Blob(encoded)
      .Run();
}

absl::Status WritePoses(SqliteDatabase& database, absl::string_view session, const std::vector<PoseSegment>& poses,
                        uint64_t next_pose_seq, SqliteSessionState& state) {
  if (poses.empty()) return absl::OkStatus();
  if (state.next_pose_seq > next_pose_seq) {
    EVPOSE_RETURN_IF_ERROR(database.Query("DELETE FROM poses WHERE session = ? AND first_pose_seq >= ?")
                               .Text(session)
                               .Integer(static_cast<int64_t>(next_pose_seq))
                               .Run());
  }
  for (const PoseSegment& segment : poses) {
    const std::string encoded =
        AddChecksum(PosesOf(session, segment.first_pose_seq, segment.last_pose_seq), segment.bytes);
    EVPOSE_RETURN_IF_ERROR(database.Query("INSERT INTO poses VALUES (?, ?, ?, ?)")
                               .Text(session)
                               .Integer(static_cast<int64_t>(segment.first_pose_seq))
                               .Integer(static_cast<int64_t>(segment.last_pose_seq))
                               .Blob(encoded)
                               .Run());
  }
  state.next_pose_seq = poses.back().last_pose_seq + 1;
  return absl::OkStatus();
}

absl::Status DeleteOldPoses(SqliteDatabase& database, absl::string_view session, const SessionCommit& commit,
                            SqliteSessionState& state) {
  if (commit.poses.empty() && commit.first_pose_seq_kept <= state.first_pose_seq_kept) return absl::OkStatus();
  state.first_pose_seq_kept = std::max(state.first_pose_seq_kept, commit.first_pose_seq_kept);
  return database.Query("DELETE FROM poses WHERE session = ?1 AND first_pose_seq < ?2 AND last_pose_seq < ?2")
      .Text(session)
      .Integer(static_cast<int64_t>(state.first_pose_seq_kept))
      .Run();
}

absl::StatusOr<std::string> ReadCheckpoint(SqliteDatabase& database, absl::string_view session, uint32_t checksum) {
  SqliteQuery query = database.Query("SELECT bytes FROM checkpoints WHERE session = ?");
  query.Text(session);
  const bool found = query.Next();
  EVPOSE_RETURN_IF_ERROR(query.status());
  if (!found && checksum == 0) return std::string();
  std::string encoded = found ? query.BlobAt(0) : std::string();
  if (ChecksumOf(encoded) != checksum)
    return absl::DataLossError(absl::StrCat(CheckpointOf(session), " is missing or damaged"));
  return VerifyChecksum(CheckpointOf(session), std::move(encoded));
}

absl::StatusOr<std::vector<PoseSegment>> ReadPoses(SqliteDatabase& database, absl::string_view session,
                                                   uint64_t after_pose_seq) {
  SqliteQuery query = database.Query(
      "SELECT first_pose_seq, last_pose_seq, bytes FROM poses WHERE session = ? AND last_pose_seq > ? "
      "ORDER BY first_pose_seq");
  query.Text(session).Integer(static_cast<int64_t>(after_pose_seq));
  std::vector<PoseSegment> poses;
  while (query.Next()) {
    const auto first = static_cast<uint64_t>(query.IntegerAt(0));
    const auto last = static_cast<uint64_t>(query.IntegerAt(1));
    EVPOSE_ASSIGN_OR_RETURN(std::string bytes, VerifyChecksum(PosesOf(session, first, last), query.BlobAt(2)));
    poses.push_back({.first_pose_seq = first, .last_pose_seq = last, .bytes = std::move(bytes)});
  }
  EVPOSE_RETURN_IF_ERROR(query.status());
  return poses;
}

}  // namespace

absl::StatusOr<uint64_t> SqliteLastFencingNumber(SqliteDatabase& database) {
  SqliteQuery query = database.Query("SELECT last FROM fencing");
  const bool found = query.Next();
  EVPOSE_RETURN_IF_ERROR(query.status());
  if (!found) return absl::DataLossError(absl::StrCat(database.path(), ": the last fencing number is missing"));
  return static_cast<uint64_t>(query.IntegerAt(0));
}

absl::Status SqliteSetLastFencingNumber(SqliteDatabase& database, uint64_t number) {
  return database.Query("UPDATE fencing SET last = ?").Integer(static_cast<int64_t>(number)).Run();
}

absl::StatusOr<uint64_t> SqliteNextFencingNumber(SqliteDatabase& database) {
  EVPOSE_ASSIGN_OR_RETURN(const uint64_t last, SqliteLastFencingNumber(database));
  EVPOSE_RETURN_IF_ERROR(SqliteSetLastFencingNumber(database, last + 1));
  return last + 1;
}

absl::Status SqliteInsertSession(SqliteDatabase& database, const SessionRecord& record, absl::string_view lifecycle,
                                 const SqliteSessionState& state) {
  if (const auto found = SqliteReadState(database, record.name); !absl::IsNotFound(found.status())) {
    return found.ok() ? SessionExistsError(record.name) : found.status();
  }
  const std::string encoded_state = EncodeState(record.name, state);
  const std::string encoded_record = EncodeRecord(record);
  const std::string encoded_lifecycle = AddChecksum(LifecycleOf(record.name), std::string(lifecycle));
  SqliteQuery query = database.Query(
      "INSERT INTO sessions (name, ended_at_ns, state, record, lifecycle, tenant, request_id, lifecycle_write) VALUES "
      "(?, ?, ?, ?, ?, ?, ?, (SELECT coalesce(max(lifecycle_write), 0) + 1 FROM sessions))");
  return BindEnd(query.Text(record.name), state.ended_at_ns)
      .Blob(encoded_state)
      .Blob(encoded_record)
      .Blob(encoded_lifecycle)
      .Text(record.tenant)
      .Text(record.request_id)
      .Run();
}

absl::StatusOr<SqliteSessionState> SqliteReadState(SqliteDatabase& database, absl::string_view session) {
  SqliteQuery query = database.Query("SELECT state FROM sessions WHERE name = ?");
  query.Text(session);
  if (!query.Next()) return query.status().ok() ? SessionNotFoundError(session) : query.status();
  return DecodeState(session, query.BlobAt(0));
}

absl::Status SqliteWriteState(SqliteDatabase& database, absl::string_view session, const SqliteSessionState& state) {
  const std::string encoded = EncodeState(session, state);
  SqliteQuery query = database.Query("UPDATE sessions SET state = ?, ended_at_ns = ? WHERE name = ?");
  return BindEnd(query.Blob(encoded), state.ended_at_ns).Text(session).Run();
}

absl::Status SqliteWriteParts(SqliteDatabase& database, absl::string_view session, const SessionCommit& commit,
                              uint64_t next_pose_seq, SqliteSessionState& state) {
  if (commit.checkpoint.has_value()) {
    EVPOSE_RETURN_IF_ERROR(WriteCheckpoint(database, session, *commit.checkpoint, state));
  }
  if (commit.lifecycle.has_value()) {
    const std::string encoded = AddChecksum(LifecycleOf(session), *commit.lifecycle);
    EVPOSE_RETURN_IF_ERROR(database
                               .Query("UPDATE sessions SET lifecycle = ?, lifecycle_write = (SELECT "
                                      "max(lifecycle_write) + 1 FROM sessions) WHERE name = ?")
                               .Blob(encoded)
                               .Text(session)
                               .Run());
  }
  if (commit.ended_at.has_value()) state.ended_at_ns = absl::ToUnixNanos(*commit.ended_at);
  EVPOSE_RETURN_IF_ERROR(WritePoses(database, session, commit.poses, next_pose_seq, state));
  return DeleteOldPoses(database, session, commit, state);
}

absl::StatusOr<SqliteSession> SqliteReadSession(SqliteDatabase& database, absl::string_view session,
                                                uint64_t after_pose_seq) {
  SqliteQuery query = database.Query("SELECT state, record, lifecycle, ended_at_ns FROM sessions WHERE name = ?");
  query.Text(session);
  if (!query.Next()) return query.status().ok() ? SessionNotFoundError(session) : query.status();
  SqliteSession read;
  EVPOSE_ASSIGN_OR_RETURN(read.state, DecodeState(session, query.BlobAt(0)));
  EVPOSE_ASSIGN_OR_RETURN(read.stored.record, DecodeRecord(session, query.BlobAt(1)));
  EVPOSE_ASSIGN_OR_RETURN(read.stored.lifecycle, VerifyChecksum(LifecycleOf(session), query.BlobAt(2)));
  if (query.IsNullAt(3) != !read.state.ended_at_ns.has_value() ||
      query.IntegerAt(3) != read.state.ended_at_ns.value_or(0)) {
    return absl::DataLossError(absl::StrCat("the end of ", session, " is damaged"));
  }
  EVPOSE_ASSIGN_OR_RETURN(read.stored.checkpoint, ReadCheckpoint(database, session, read.state.checkpoint_checksum));
  EVPOSE_ASSIGN_OR_RETURN(read.stored.poses, ReadPoses(database, session, after_pose_seq));
  EVPOSE_RETURN_IF_ERROR(CheckWhole(session, read.stored.poses,
                                    std::max(read.state.first_pose_seq_kept, after_pose_seq + 1),
                                    read.state.next_pose_seq));
  return read;
}

absl::Status SqliteDeleteSession(SqliteDatabase& database, absl::string_view session) {
  EVPOSE_RETURN_IF_ERROR(database.Query("DELETE FROM sessions WHERE name = ?").Text(session).Run());
  EVPOSE_RETURN_IF_ERROR(database.Query("DELETE FROM checkpoints WHERE session = ?").Text(session).Run());
  return database.Query("DELETE FROM poses WHERE session = ?").Text(session).Run();
}

absl::StatusOr<std::string> SqliteReadTenant(SqliteDatabase& database, absl::string_view session) {
  SqliteQuery query = database.Query("SELECT tenant FROM sessions WHERE name = ?");
  query.Text(session);
  if (!query.Next()) return query.status().ok() ? SessionNotFoundError(session) : query.status();
  return query.TextAt(0);
}

absl::StatusOr<SessionPage> SqliteListSessions(SqliteDatabase& database, absl::string_view tenant,
                                               absl::string_view after_name, size_t max_sessions) {
  SqliteQuery query =
      database.Query("SELECT name, record FROM sessions WHERE tenant = ? AND name > ? ORDER BY name LIMIT ?");
  query.Text(tenant).Text(after_name).Integer(static_cast<int64_t>(max_sessions));
  SessionPage page;
  size_t num_rows = 0;
  while (query.Next()) {
    ++num_rows;
    page.last_name = query.TextAt(0);
    // A record that was damaged after the store was opened is skipped here; reading the session reports it.
    auto record = DecodeRecord(page.last_name, query.BlobAt(1));
    if (record.ok()) page.records.push_back(*std::move(record));
  }
  EVPOSE_RETURN_IF_ERROR(query.status());
  if (num_rows < max_sessions) page.last_name.clear();
  return page;
}

absl::StatusOr<SessionRecord> SqliteFindRequest(SqliteDatabase& database, absl::string_view tenant,
                                                absl::string_view request_id) {
  SqliteQuery query =
      database.Query("SELECT name, record FROM sessions WHERE tenant = ? AND request_id = ? AND request_id <> ''");
  query.Text(tenant).Text(request_id);
  if (!query.Next()) return query.status().ok() ? RequestNotFoundError(request_id) : query.status();
  return DecodeRecord(query.TextAt(0), query.BlobAt(1));
}

absl::StatusOr<std::vector<SessionOwner>> SqliteListOwners(SqliteDatabase& database) {
  std::vector<SessionOwner> owners;
  SqliteQuery query = database.Query("SELECT name, tenant FROM sessions INDEXED BY sessions_of_tenant");
  while (query.Next()) owners.push_back({.name = query.TextAt(0), .tenant = query.TextAt(1)});
  EVPOSE_RETURN_IF_ERROR(query.status());
  std::sort(owners.begin(), owners.end(), [](const auto& a, const auto& b) { return a.name < b.name; });
  return owners;
}

absl::StatusOr<std::vector<StoredLifecycle>> SqliteReadOldestLifecycles(SqliteDatabase& database, size_t max_sessions) {
  std::vector<StoredLifecycle> lifecycles;
  SqliteQuery query = database.Query("SELECT name, lifecycle FROM sessions ORDER BY lifecycle_write");
  while (lifecycles.size() < max_sessions && query.Next()) {
    std::string name = query.TextAt(0);
    auto lifecycle = VerifyChecksum(LifecycleOf(name), query.BlobAt(1));
    if (lifecycle.ok()) lifecycles.push_back({.name = std::move(name), .lifecycle = *std::move(lifecycle)});
  }
  EVPOSE_RETURN_IF_ERROR(query.status());
  return lifecycles;
}

absl::Status SqliteUpgradeFromVersion1(SqliteDatabase& database) {
  EVPOSE_RETURN_IF_ERROR(database.Execute(kSqliteAdditionsToVersion1));
  std::vector<SessionRecord> records;
  {
    SqliteQuery query = database.Query("SELECT name, record FROM sessions");
    while (query.Next()) {
      auto record = DecodeRecord(query.TextAt(0), query.BlobAt(1));
      if (record.ok()) records.push_back(*std::move(record));
    }
    EVPOSE_RETURN_IF_ERROR(query.status());
  }
  for (const SessionRecord& record : records) {
    EVPOSE_RETURN_IF_ERROR(database.Query("UPDATE sessions SET tenant = ?, request_id = ? WHERE name = ?")
                               .Text(record.tenant)
                               .Text(record.request_id)
                               .Text(record.name)
                               .Run());
  }
  return absl::OkStatus();
}

absl::StatusOr<std::string> SqliteOldestEndedSession(SqliteDatabase& database) {
  SqliteQuery query =
      database.Query("SELECT name FROM sessions WHERE ended_at_ns IS NOT NULL ORDER BY ended_at_ns, name LIMIT 1");
  const bool found = query.Next();
  EVPOSE_RETURN_IF_ERROR(query.status());
  return found ? query.TextAt(0) : std::string();
}

absl::StatusOr<std::vector<std::string>> SqliteSessionsEndedBefore(SqliteDatabase& database, absl::Time time) {
  SqliteQuery query = database.Query(
      "SELECT name FROM sessions WHERE ended_at_ns IS NOT NULL AND ended_at_ns < ? ORDER BY ended_at_ns, name");
  query.Integer(absl::ToUnixNanos(time));
  std::vector<std::string> names;
  while (query.Next()) names.push_back(query.TextAt(0));
  EVPOSE_RETURN_IF_ERROR(query.status());
  return names;
}

absl::Status SqlitePutModel(SqliteDatabase& database, const ModelRecord& model) {
  const std::string header = EncodeModelHeader(model);
  const std::string bytes = EncodeModelBytes(model);
  return database.Query("INSERT OR REPLACE INTO models (name, tenant, header, bytes) VALUES (?, ?, ?, ?)")
      .Text(model.name)
      .Text(model.tenant)
      .Blob(header)
      .Blob(bytes)
      .Run();
}

absl::StatusOr<ModelRecord> SqliteReadModel(SqliteDatabase& database, absl::string_view tenant,
                                            absl::string_view name) {
  SqliteQuery query = database.Query("SELECT header, bytes FROM models WHERE name = ? AND tenant = ?");
  query.Text(name).Text(tenant);
  if (!query.Next()) return query.status().ok() ? ModelNotFoundError(name) : query.status();
  const std::string bytes = query.BlobAt(1);
  EVPOSE_ASSIGN_OR_RETURN(ModelRecord model, DecodeModelHeader(tenant, name, query.BlobAt(0), bytes.size()));
  EVPOSE_RETURN_IF_ERROR(DecodeModelBytes(bytes, model));
  return model;
}

absl::StatusOr<bool> SqliteHasModel(SqliteDatabase& database, absl::string_view tenant, absl::string_view name) {
  SqliteQuery query = database.Query("SELECT 1 FROM models WHERE name = ? AND tenant = ?");
  query.Text(name).Text(tenant);
  const bool is_found = query.Next();
  EVPOSE_RETURN_IF_ERROR(query.status());
  return is_found;
}

absl::Status SqliteDeleteModel(SqliteDatabase& database, absl::string_view tenant, absl::string_view name) {
  return database.Query("DELETE FROM models WHERE name = ? AND tenant = ?").Text(name).Text(tenant).Run();
}

absl::StatusOr<std::vector<ModelRecord>> SqliteListModels(SqliteDatabase& database) {
  std::vector<ModelRecord> models;
  SqliteQuery query = database.Query("SELECT name, tenant, header, length(bytes) FROM models ORDER BY name, tenant");
  while (query.Next()) {
    // A record that was damaged after the store was opened is skipped here; reading the model reports it.
    auto model =
        DecodeModelHeader(query.TextAt(1), query.TextAt(0), query.BlobAt(2), static_cast<uint64_t>(query.IntegerAt(3)));
    if (model.ok()) models.push_back(*std::move(model));
  }
  EVPOSE_RETURN_IF_ERROR(query.status());
  return models;
}

}  // namespace evpose::server
