// SPDX-License-Identifier: Apache-2.0

// The tables of the store and the settings of its connections.
#pragma once

#include "absl/status/status.h"
#include "server/stores/postgres/postgres_connection.h"

namespace evpose::server {

// The version of the tables that this program reads and writes.
inline constexpr int kPostgresSchemaVersion = 1;

// Creates the tables in an empty database, and checks the version of existing ones. Several servers may do so at the
// same time: the first one creates them, and the others wait for it. Errors: FAILED_PRECONDITION for tables of a later
// version and for a PostgreSQL that is too old or loses acknowledged commits by its settings; PERMISSION_DENIED if the
// role may not create the schema.
absl::Status CreatePostgresSchema(PostgresConnection& connection, absl::string_view address);

// Sets what the store needs on a new connection: durable commits, limits of waits for locks and of statements, and
// prepares the statements. The tables exist. Errors: FAILED_PRECONDITION if `synchronous_commit` is neither `on` nor
// `remote_apply` although it was set.
absl::Status SetUpPostgresConnection(PostgresConnection& connection, absl::string_view address);

}  // namespace evpose::server
