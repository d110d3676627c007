// SPDX-License-Identifier: Apache-2.0

// The statements of the store, and the records in their rows. Errors of all functions that read rows: DATA_LOSS naming
// the damaged part.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/store.h"
#include "server/stores/postgres/postgres_connection.h"

namespace evpose::server {

// Transactions. A writing one locks the lease of each session first, by kPostgresLock: the other statements of the
// transaction then see all earlier writes to the session.
extern const PostgresStatement kPostgresBegin;
extern const PostgresStatement kPostgresBeginReading;  // all statements read one snapshot
extern const PostgresStatement kPostgresCommit;
extern const PostgresStatement kPostgresLock;  // $1 session; the row of ParsePostgresLease()

// Parameters: name, tenant, request_id, record, lifecycle, holder, bytes of both records. Returns the fencing number;
// no row when the session, or one of the same request_id, exists.
extern const PostgresStatement kPostgresCreate;
extern const PostgresStatement kPostgresAcquire;       // $1 session, $2 holder
extern const PostgresStatement kPostgresReadSession;   // $1 session
extern const PostgresStatement kPostgresReadPoses;     // $1 session, $2 the last pose that is not wanted
extern const PostgresStatement kPostgresReadTenant;    // $1 session
extern const PostgresStatement kPostgresListSessions;  // $1 tenant, $2 after this name, $3 maximum: name, record
extern const PostgresStatement kPostgresFindRequest;   // $1 tenant, $2 request_id: name, record
extern const PostgresStatement kPostgresListOwners;    // name, tenant
// $1 after this number of a write, $2 maximum: name, lifecycle, number of the write
extern const PostgresStatement kPostgresOldestLifecycles;
extern const PostgresStatement kPostgresSomeSessions;  // $1 maximum: name

extern const PostgresStatement kPostgresDeletePoses;    // $1 session
extern const PostgresStatement kPostgresDeleteLease;    // $1 session
extern const PostgresStatement kPostgresDeleteSession;  // $1 session
extern const PostgresStatement kPostgresLockEnded;      // $1 ended before this time, $2 maximum: session

extern const PostgresStatement kPostgresPutModel;     // $1 name, $2 tenant, $3 header, $4 bytes
extern const PostgresStatement kPostgresReadModel;    // $1 name, $2 tenant: header, bytes
extern const PostgresStatement kPostgresHasModel;     // $1 name, $2 tenant: a row if the model exists
extern const PostgresStatement kPostgresDeleteModel;  // $1 name, $2 tenant
extern const PostgresStatement kPostgresListModels;   // name, tenant, header, size of the bytes

extern const PostgresStatement kPostgresUsedBytes;  // the bytes of all sessions and models
extern const PostgresStatement kPostgresHealth;     // writes to the log, so that it waits for synchronous standbys
extern const PostgresStatement kPostgresCancel;     // $1 process()

std::vector<const PostgresStatement*> AllPostgresStatements();

// The values of a session that each commit changes.
struct PostgresLease {
  FencingToken token;
  uint64_t last_commit = 0;
  uint64_t next_pose_seq = 1;
  uint64_t first_pose_seq_kept = 1;
};

// Errors: NOT_FOUND if there is no row.
absl::StatusOr<PostgresLease> ParsePostgresLease(absl::string_view session, const PostgresRows& rows);

// A commit with the checksums of its records.
struct PostgresCommit {
  PostgresCommit(absl::string_view session_name, const FencingToken& lease_token, const CommitPlace& commit_place,
                 SessionCommit commit);

  std::string session;
  FencingToken token;
  CommitPlace place;
  std::optional<std::string> checkpoint;
  std::optional<std::string> lifecycle;
  std::vector<PoseSegment> poses;
  uint64_t first_pose_seq_kept = 1;
  std::optional<int64_t> ended_at_ns;
  uint64_t size_bytes = 0;
};

// Checks whether the lease may write `commit` to a session that has these values. Errors: those of
// SessionLease::Commit().
absl::Status CheckPostgresCommit(const PostgresCommit& commit, const PostgresLease& stored);
// Adds the commands that write the commit. They refer to the bytes in it. The session is locked.
void AddPostgresCommit(const PostgresCommit& commit, const PostgresLease& stored,
                       std::vector<PostgresCommand>& commands);
// Adds the commands that delete a session. They refer to the name. The session is locked.
void AddPostgresDeletion(absl::string_view session, std::vector<PostgresCommand>& commands);

struct PostgresSession {
  StoredSession stored;
  uint64_t fencing_number = 0;
  uint64_t next_pose_seq = 1;
};

// Parses the rows of kPostgresReadSession and kPostgresReadPoses. Errors: NOT_FOUND.
absl::StatusOr<PostgresSession> ParsePostgresSession(absl::string_view name, uint64_t after_pose_seq,
                                                     const PostgresRows& session, const PostgresRows& poses);

}  // namespace evpose::server
