// SPDX-License-Identifier: Apache-2.0
#include "server/stores/postgres/postgres_records.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/stores/common/checked_records.h"

namespace evpose::server {

const PostgresStatement kPostgresBegin = {"begin", "BEGIN ISOLATION LEVEL READ COMMITTED"};
const PostgresStatement kPostgresBeginReading = {"begin_reading", "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY"};
const PostgresStatement kPostgresCommit = {"commit", "COMMIT"};
const PostgresStatement kPostgresLock = {"lock", R"sql(
SELECT fencing, holder, last_commit, next_pose_seq, first_pose_seq_kept FROM evpose.leases WHERE session = $1
FOR UPDATE)sql"};

const PostgresStatement kPostgresCreate = {"create", R"sql(
WITH created AS (
  INSERT INTO evpose.sessions (name, tenant, request_id, record, lifecycle, lifecycle_write)
  VALUES ($1, $2, $3, $4, $5, nextval('evpose.lifecycle_writes')) ON CONFLICT DO NOTHING RETURNING name)
INSERT INTO evpose.leases (session, fencing, holder, last_commit, next_pose_seq, first_pose_seq_kept, size_bytes)
SELECT name, nextval('evpose.fencing'), $6, 0, 1, 1, $7 FROM created RETURNING fencing)sql"};
const PostgresStatement kPostgresAcquire = {"acquire", R"sql(
UPDATE evpose.leases SET fencing = nextval('evpose.fencing'), holder = $2, last_commit = 0 WHERE session = $1)sql"};
const PostgresStatement kPostgresReadSession = {"read_session", R"sql(
SELECT l.fencing, l.next_pose_seq, l.first_pose_seq_kept, s.record, s.lifecycle, l.checkpoint
FROM evpose.sessions s JOIN evpose.leases l ON l.session = s.name WHERE s.name = $1)sql"};
const PostgresStatement kPostgresReadPoses = {"read_poses", R"sql(
SELECT first_pose_seq, last_pose_seq, bytes FROM evpose.poses
WHERE session = $1 AND last_pose_seq > $2 AND first_pose_seq >= coalesce(
  (SELECT max(first_pose_seq) FROM evpose.poses WHERE session = $1 AND first_pose_seq <= $2), 0)
ORDER BY first_pose_seq)sql"};
const PostgresStatement kPostgresReadTenant = {"read_tenant", "SELECT tenant FROM evpose.sessions WHERE name = $1"};
const PostgresStatement kPostgresListSessions = {"list_sessions", R"sql(
SELECT name, record FROM evpose.sessions WHERE tenant = $1 AND name > $2 ORDER BY name LIMIT $3)sql"};
const PostgresStatement kPostgresFindRequest = {"find_request", R"sql(
SELECT name, record FROM evpose.sessions WHERE tenant = $1 AND request_id = $2 AND request_id <> ''::bytea)sql"};
const PostgresStatement kPostgresListOwners = {"list_owners", R"sql(
SELECT name, tenant FROM evpose.sessions ORDER BY name)sql"};
const PostgresStatement kPostgresOldestLifecycles = {"oldest_lifecycles", R"sql(
SELECT name, lifecycle, lifecycle_write FROM evpose.sessions WHERE lifecycle_write > $1
ORDER BY lifecycle_write LIMIT $2)sql"};
const PostgresStatement kPostgresSomeSessions = {"some_sessions", "SELECT name FROM evpose.sessions LIMIT $1"};

const PostgresStatement kPostgresDeletePoses = {"delete_poses", "DELETE FROM evpose.poses WHERE session = $1"};
const PostgresStatement kPostgresDeleteLease = {"delete_lease", "DELETE FROM evpose.leases WHERE session = $1"};
const PostgresStatement kPostgresDeleteSession = {"delete_session", "DELETE FROM evpose.sessions WHERE name = $1"};
const PostgresStatement kPostgresLockEnded = {"lock_ended", R"sql(
SELECT session FROM evpose.leases WHERE ended_at_ns < $1 ORDER BY ended_at_ns, session LIMIT $2 FOR UPDATE)sql"};

const PostgresStatement kPostgresPutModel = {"put_model", R"sql(
INSERT INTO evpose.models (name, tenant, header, bytes) VALUES ($1, $2, $3, $4)
ON CONFLICT (name, tenant) DO UPDATE SET header = excluded.header, bytes = excluded.bytes)sql"};
const PostgresStatement kPostgresReadModel = {"read_model", R"sql(
SELECT header, bytes FROM evpose.models WHERE name = $1 AND tenant = $2)sql"};
const PostgresStatement kPostgresHasModel = {"has_model", R"sql(
SELECT name FROM evpose.models WHERE name = $1 AND tenant = $2)sql"};
const PostgresStatement kPostgresDeleteModel = {"delete_model", R"sql(
DELETE FROM evpose.models WHERE name = $1 AND tenant = $2)sql"};
const PostgresStatement kPostgresListModels = {"list_models", R"sql(
SELECT name, tenant, header, octet_length(bytes)::bigint FROM evpose.models ORDER BY name, tenant)sql"};

const PostgresStatement kPostgresUsedBytes = {"used_bytes", R"sql(
SELECT coalesce((SELECT sum(size_bytes) FROM evpose.leases), 0)::bigint +
  coalesce((SELECT sum(octet_length(bytes)) FROM evpose.models), 0))sql"};
const PostgresStatement kPostgresHealth = {"health", "SELECT pg_catalog.pg_logical_emit_message(true, 'evpose', '')"};
const PostgresStatement kPostgresCancel = {"cancel", "SELECT pg_catalog.pg_cancel_backend($1::bigint::integer)"};

namespace {

// $1 session, $2 the first pose that is replaced, $3 the first pose that is kept, $4 number of the commit, $5 the next
// pose, $6 the time of the end or null, $7 bytes that are added, and $8 the checkpoint. A pose before $2 and a pose
// from $2 on are different rows, because a statement may delete a row once only.
const std::string kWriteCommit = R"sql(
WITH replaced AS (
  DELETE FROM evpose.poses WHERE session = $1 AND first_pose_seq >= $2 RETURNING octet_length(bytes) AS size),
forgotten AS (
  DELETE FROM evpose.poses WHERE session = $1 AND first_pose_seq < $2 AND first_pose_seq < $3 AND last_pose_seq < $3
  RETURNING octet_length(bytes) AS size)
UPDATE evpose.leases SET first_pose_seq_kept = $3, last_commit = $4, next_pose_seq = $5,
  ended_at_ns = coalesce($6, ended_at_ns), size_bytes = size_bytes + $7
  - coalesce((SELECT sum(size) FROM replaced), 0) - coalesce((SELECT sum(size) FROM forgotten), 0))sql";
const std::string kWithoutCheckpoint = kWriteCommit + " WHERE session = $1";
const std::string kWithCheckpoint =
    kWriteCommit + " - coalesce(octet_length(checkpoint), 0), checkpoint = $8 WHERE session = $1";
const PostgresStatement kPostgresWriteCommit = {"write_commit", kWithoutCheckpoint.c_str()};
const PostgresStatement kPostgresWriteCheckpoint = {"write_checkpoint", kWithCheckpoint.c_str()};
const PostgresStatement kPostgresWriteLifecycle = {"write_lifecycle", R"sql(
UPDATE evpose.sessions SET lifecycle = $2, lifecycle_write = nextval('evpose.lifecycle_writes') WHERE name = $1)sql"};
const PostgresStatement kPostgresInsertPoses = {"insert_poses", R"sql(
INSERT INTO evpose.poses (session, first_pose_seq, last_pose_seq, bytes) VALUES ($1, $2, $3, $4))sql"};

}  // namespace

std::vector<const PostgresStatement*> AllPostgresStatements() {
  return {&kPostgresBegin,
          &kPostgresBeginReading,
          &kPostgresCommit,
          &kPostgresLock,
          &kPostgresCreate,
          &kPostgresAcquire,
          &kPostgresReadSession,
          &kPostgresReadPoses,
          &kPostgresReadTenant,
          &kPostgresListSessions,
          &kPostgresFindRequest,
          &kPostgresListOwners,
          &kPostgresOldestLifecycles,
          &kPostgresSomeSessions,
          &kPostgresDeletePoses,
          &kPostgresDeleteLease,
          &kPostgresDeleteSession,
          &kPostgresLockEnded,
          &kPostgresPutModel,
          &kPostgresReadModel,
          &kPostgresHasModel,
          &kPostgresDeleteModel,
          &kPostgresListModels,
          &kPostgresUsedBytes,
          &kPostgresHealth,
          &kPostgresCancel,
          &kPostgresWriteCommit,
          &kPostgresWriteCheckpoint,
          &kPostgresWriteLifecycle,
          &kPostgresInsertPoses};
}

absl::StatusOr<PostgresLease> ParsePostgresLease(absl::string_view session, const PostgresRows& rows) {
  if (rows.size() == 0) return SessionNotFoundError(session);
  return PostgresLease{.token = {.number = rows.Unsigned(0, 0), .holder = rows.Bytes(0, 1)},
                       .last_commit = rows.Unsigned(0, 2),
                       .next_pose_seq = rows.Unsigned(0, 3),
                       .first_pose_seq_kept = rows.Unsigned(0, 4)};
}

PostgresCommit::PostgresCommit(absl::string_view session_name, const FencingToken& lease_token,
                               const CommitPlace& commit_place, SessionCommit commit)
    : session(session_name),
      token(lease_token),
      place(commit_place),
      poses(std::move(commit.poses)),
      first_pose_seq_kept(commit.first_pose_seq_kept) {
  if (commit.checkpoint.has_value()) checkpoint = CopyWithChecksum(CheckpointOf(session), *commit.checkpoint);
  if (commit.lifecycle.has_value()) lifecycle = AddChecksum(LifecycleOf(session), *std::move(commit.lifecycle));
  if (commit.ended_at.has_value()) ended_at_ns = absl::ToUnixNanos(*commit.ended_at);
  size_bytes = checkpoint.has_value() ? checkpoint->size() : 0;
  for (PoseSegment& segment : poses) {
    segment.bytes =
        AddChecksum(PosesOf(session, segment.first_pose_seq, segment.last_pose_seq), std::move(segment.bytes));
    size_bytes += segment.bytes.size();
  }
}

absl::Status CheckPostgresCommit(const PostgresCommit& commit, const PostgresLease& stored) {
  EVPOSE_RETURN_IF_ERROR(CheckHolder(commit.session, stored.token, commit.token));
  if (stored.last_commit < commit.place.last_ok) return RolledBackError(commit.session, commit.token.number);
  if (stored.last_commit < commit.place.number) return absl::OkStatus();
  return absl::UnavailableError(absl::StrCat("a commit of ", commit.session, " arrived after a later one"));
}

void AddPostgresCommit(const PostgresCommit& commit, const PostgresLease& stored,
                       std::vector<PostgresCommand>& commands) {
  const uint64_t kept = std::max(stored.first_pose_seq_kept, commit.first_pose_seq_kept);
  // Only a commit with poses replaces poses.
  const uint64_t first_replaced =
      commit.poses.empty() ? std::numeric_limits<int64_t>::max() : commit.place.next_pose_seq;
  const uint64_t next = commit.poses.empty() ? stored.next_pose_seq : commit.poses.back().last_pose_seq + 1;
  uint64_t added_bytes = commit.checkpoint.has_value() ? commit.checkpoint->size() : 0;
  std::vector<PostgresCommand> insertions;
  for (const PoseSegment& segment : commit.poses) {
    if (segment.last_pose_seq < kept) continue;
    added_bytes += segment.bytes.size();
    insertions.push_back({.statement = &kPostgresInsertPoses,
                          .values = {commit.session, segment.first_pose_seq, segment.last_pose_seq, segment.bytes}});
  }
  PostgresCommand write = {
      .statement = &kPostgresWriteCommit,
      .values = {commit.session, first_replaced, kept, commit.place.number, next,
                 commit.ended_at_ns.has_value() ? PostgresValue(*commit.ended_at_ns) : PostgresValue::Null(),
                 added_bytes}};
  if (commit.checkpoint.has_value()) {
    write.statement = &kPostgresWriteCheckpoint;
    write.values.emplace_back(*commit.checkpoint);
  }
  commands.push_back(std::move(write));
  std::move(insertions.begin(), insertions.end(), std::back_inserter(commands));
  if (commit.lifecycle.has_value()) {
    commands.push_back({.statement = &kPostgresWriteLifecycle, .values = {commit.session, *commit.lifecycle}});
  }
}

void AddPostgresDeletion(absl::string_view session, std::vector<PostgresCommand>& commands) {
  for (const PostgresStatement* const statement :
       {&kPostgresDeletePoses, &kPostgresDeleteLease, &kPostgresDeleteSession}) {
    commands.push_back({.statement = statement, .values = {session}});
  }
}

absl::StatusOr<PostgresSession> ParsePostgresSession(absl::string_view name, uint64_t after_pose_seq,
                                                     const PostgresRows& session, const PostgresRows& poses) {
  if (session.size() == 0) return SessionNotFoundError(name);
  PostgresSession read;
  read.fencing_number = session.Unsigned(0, 0);
  read.next_pose_seq = session.Unsigned(0, 1);
  const uint64_t kept = session.Unsigned(0, 2);
  EVPOSE_ASSIGN_OR_RETURN(read.stored.record, DecodeRecord(name, session.Bytes(0, 3)));
  EVPOSE_ASSIGN_OR_RETURN(read.stored.lifecycle, VerifyChecksum(LifecycleOf(name), session.Bytes(0, 4)));
  if (!session.IsNull(0, 5)) {
    EVPOSE_ASSIGN_OR_RETURN(read.stored.checkpoint, VerifyChecksum(CheckpointOf(name), session.Bytes(0, 5)));
  }
  for (size_t row = 0; row < poses.size(); ++row) {
    const uint64_t first = poses.Unsigned(row, 0);
    const uint64_t last = poses.Unsigned(row, 1);
    EVPOSE_ASSIGN_OR_RETURN(std::string bytes, VerifyChecksum(PosesOf(name, first, last), poses.Bytes(row, 2)));
    read.stored.poses.push_back({.first_pose_seq = first, .last_pose_seq = last, .bytes = std::move(bytes)});
  }
  EVPOSE_RETURN_IF_ERROR(CheckWhole(name, read.stored.poses, std::max(kept, after_pose_seq + 1), read.next_pose_seq));
  return read;
}

}  // namespace evpose::server
