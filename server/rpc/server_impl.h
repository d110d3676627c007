// SPDX-License-Identifier: Apache-2.0

// Starting a server with a given factory of trackers and a given store, for tests.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "server/rpc/server.h"
#include "server/sessions/types/session_config.h"
#include "server/stores/common/store.h"

namespace evpose::server {

absl::StatusOr<std::unique_ptr<Server>> StartServer(const ServerOptions& options, TrackerFactory make_tracker);
// Uses `store` instead of options.store.
absl::StatusOr<std::unique_ptr<Server>> StartServer(const ServerOptions& options, TrackerFactory make_tracker,
                                                    std::unique_ptr<Store> store);

}  // namespace evpose::server
