// SPDX-License-Identifier: Apache-2.0

// A store in PostgreSQL, which several servers share: each of them can acquire any session.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "server/stores/common/store.h"
#include "server/stores/postgres/postgres_client.h"

namespace evpose::server {

struct PostgresStoreOptions {
  PostgresClientOptions client;
  // Largest number of sessions and models that are read completely at the start: some tenths of a second.
  size_t max_checked_records = 256;
};

// Opens the store, creates its tables if the database has none, and reads all models and sessions once, unless there
// are too many, to find damaged ones. A commit is on the disk of PostgreSQL when it is acknowledged, and on those of
// the synchronous standbys (`synchronous_standby_names`). Errors: UNAVAILABLE; PERMISSION_DENIED; FAILED_PRECONDITION
// for a missing database, for tables of a later version, and for a PostgreSQL that is too old or would lose
// acknowledged commits.
absl::StatusOr<std::unique_ptr<Store>> OpenPostgresStore(const PostgresStoreOptions& options);

}  // namespace evpose::server
