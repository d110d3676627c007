// SPDX-License-Identifier: Apache-2.0
#include "server/stores/postgres/postgres_schema.h"

#include <string>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/stores/postgres/postgres_records.h"

namespace evpose::server {
namespace {

constexpr int kOldestVersion = 130000;  // PostgreSQL 13

// Names, tenants and request_ids are bytea, which has one order in all databases and no byte that it rejects. Every
// record has a checksum (checked_records.h). Values in `leases` change with each commit: they are in a table of their
// own, with room on its pages, so that a commit changes no index. A checkpoint that is not written anew is not copied,
// because it is kept outside of the row. What sessions write is not compressed again.
const char* const kCreateTables = R"sql(
CREATE TABLE evpose.schema_version (version integer NOT NULL);
CREATE SEQUENCE evpose.fencing;
CREATE SEQUENCE evpose.lifecycle_writes;
CREATE TABLE evpose.models (
  name bytea NOT NULL, tenant bytea NOT NULL, header bytea NOT NULL, bytes bytea NOT NULL,
  PRIMARY KEY (name, tenant));
CREATE TABLE evpose.sessions (
  name bytea NOT NULL PRIMARY KEY, tenant bytea NOT NULL, request_id bytea NOT NULL, record bytea NOT NULL,
  lifecycle bytea NOT NULL, lifecycle_write bigint NOT NULL) WITH (fillfactor = 80);
CREATE UNIQUE INDEX sessions_of_tenant ON evpose.sessions (tenant, name);
CREATE UNIQUE INDEX sessions_of_request ON evpose.sessions (tenant, request_id) WHERE request_id <> ''::bytea;
CREATE INDEX sessions_by_lifecycle_write ON evpose.sessions (lifecycle_write);
CREATE TABLE evpose.leases (
  session bytea NOT NULL PRIMARY KEY, fencing bigint NOT NULL, holder bytea NOT NULL, last_commit bigint NOT NULL,
  next_pose_seq bigint NOT NULL, first_pose_seq_kept bigint NOT NULL, ended_at_ns bigint, size_bytes bigint NOT NULL,
  checkpoint bytea)
  WITH (fillfactor = 50, toast.autovacuum_vacuum_scale_factor = 0.05, toast.autovacuum_vacuum_cost_delay = 0);
CREATE INDEX leases_ended ON evpose.leases (ended_at_ns, session) WHERE ended_at_ns IS NOT NULL;
CREATE TABLE evpose.poses (
  session bytea NOT NULL, first_pose_seq bigint NOT NULL, last_pose_seq bigint NOT NULL, bytes bytea NOT NULL,
  PRIMARY KEY (session, first_pose_seq))
  WITH (autovacuum_vacuum_scale_factor = 0.05, autovacuum_vacuum_cost_delay = 0,
        toast.autovacuum_vacuum_scale_factor = 0.05, toast.autovacuum_vacuum_cost_delay = 0);
ALTER TABLE evpose.models ALTER COLUMN bytes SET STORAGE EXTERNAL;
ALTER TABLE evpose.leases ALTER COLUMN checkpoint SET STORAGE EXTERNAL;
ALTER TABLE evpose.poses ALTER COLUMN bytes SET STORAGE EXTERNAL;
INSERT INTO evpose.schema_version VALUES (1);
)sql";

// The number of the lock is random, and the same in all servers.
const char* const kLock = "BEGIN; SELECT pg_advisory_xact_lock(6072349817234561)";

absl::StatusOr<bool> Exists(PostgresConnection& connection, const char* sql) {
  EVPOSE_ASSIGN_OR_RETURN(const PostgresRows rows, connection.Execute(sql));
  return rows.size() > 0 && rows.Bytes(0, 0) == "t";
}

absl::StatusOr<bool> TablesExist(PostgresConnection& connection) {
  return Exists(connection,
                "SELECT EXISTS (SELECT FROM pg_catalog.pg_class c JOIN pg_catalog.pg_namespace n ON "
                "n.oid = c.relnamespace WHERE n.nspname = 'evpose' AND c.relname = 'schema_version')");
}

absl::Status CreateTables(PostgresConnection& connection) {
  EVPOSE_RETURN_IF_ERROR(connection.Execute(kLock).status());
  EVPOSE_ASSIGN_OR_RETURN(const bool has_tables, TablesExist(connection));
  if (!has_tables) {
    // An administrator may have created the schema for a role that may not create schemas.
    EVPOSE_ASSIGN_OR_RETURN(
        const bool has_schema,
        Exists(connection, "SELECT EXISTS (SELECT FROM pg_catalog.pg_namespace WHERE nspname = 'evpose')"));
    if (!has_schema) EVPOSE_RETURN_IF_ERROR(connection.Execute("CREATE SCHEMA evpose").status());
    EVPOSE_RETURN_IF_ERROR(connection.Execute(kCreateTables).status());
  }
  return connection.Execute("COMMIT").status();
}

absl::StatusOr<std::string> Setting(PostgresConnection& connection, const char* sql) {
  EVPOSE_ASSIGN_OR_RETURN(const PostgresRows rows, connection.Execute(sql));
  return rows.size() > 0 ? rows.Bytes(0, 0) : std::string();
}

absl::Status CheckServer(PostgresConnection& connection, absl::string_view address) {
  if (connection.version() < kOldestVersion) {
    return absl::FailedPreconditionError(absl::StrCat(address, " is PostgreSQL ", connection.version() / 10000,
                                                      ": the store needs ", kOldestVersion / 10000, " or later"));
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::string fsync, Setting(connection, "SHOW fsync"));
  if (fsync == "on") return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat(
      address, " has fsync = ", fsync, ", and would lose acknowledged commits in a power failure: set it to on"));
}

// `lock_timeout`: another server holds a lock during its commit. `idle_in_transaction_session_timeout`: a server that
// stops in the middle of a transaction would otherwise keep its locks until its connection ends. `synchronous_commit`:
// `remote_apply` waits longer than `on`, and is kept.
const char* const kPostgresSettings = R"sql(
SET standard_conforming_strings = on;
SET client_min_messages = warning;
SET bytea_output = hex;
SET statement_timeout = '60s';
SET lock_timeout = '1s';
SET idle_in_transaction_session_timeout = '10s';
SELECT pg_catalog.set_config('synchronous_commit', 'on', false)
  WHERE pg_catalog.current_setting('synchronous_commit') <> 'remote_apply';
SHOW synchronous_commit
)sql";

}  // namespace

absl::Status CreatePostgresSchema(PostgresConnection& connection, absl::string_view address) {
  EVPOSE_RETURN_IF_ERROR(CheckServer(connection, address));
  EVPOSE_ASSIGN_OR_RETURN(const bool has_tables, TablesExist(connection));
  if (!has_tables) {
    const absl::Status created = CreateTables(connection);
    if (absl::IsPermissionDenied(created)) {
      return absl::PermissionDeniedError(
          absl::StrCat(created.message(),
                       ": grant CREATE on the database to the role of --store, or create the schema "
                       "evpose as the administrator and make the role its owner"));
    }
    EVPOSE_RETURN_IF_ERROR(created);
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::string text,
                          Setting(connection, "SELECT max(version) FROM evpose.schema_version"));
  int version = 0;
  if (!absl::SimpleAtoi(text, &version) || version < 1) {
    return absl::DataLossError(
        absl::StrCat(address, ": the version in the table evpose.schema_version is missing: restore a backup"));
  }
  if (version <= kPostgresSchemaVersion) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(address, " has tables of schema version ", version, ", later than version ", kPostgresSchemaVersion,
                   " of this server: use a later version of evpose-server, or another database"));
}

absl::Status SetUpPostgresConnection(PostgresConnection& connection, absl::string_view address) {
  EVPOSE_ASSIGN_OR_RETURN(const PostgresRows rows, connection.Execute(kPostgresSettings));
  const std::string durability = rows.size() > 0 ? rows.Bytes(0, 0) : "";
  if (durability != "on" && durability != "remote_apply") {
    return absl::FailedPreconditionError(
        absl::StrCat(address, " does not let the role of --store set synchronous_commit, which is ", durability,
                     ": it must be on or remote_apply, or acknowledged commits can be lost"));
  }
  return connection.Prepare(AllPostgresStatements());
}

}  // namespace evpose::server
