// SPDX-License-Identifier: Apache-2.0

// Server with the trackers that its sessions use, and its store, given from outside: for tests.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "server/rpc/server.h"
#include "server/sessions/types/session_config.h"
#include "server/stores/common/store.h"

namespace evpose::server {

absl::StatusOr<std::unique_ptr<Server>> StartServer(const ServerOptions& options, TrackerFactory make_tracker);
// On `store` instead of one that the options describe.
absl::StatusOr<std::unique_ptr<Server>> StartServer(const ServerOptions& options, TrackerFactory make_tracker,
                                                    std::unique_ptr<Store> store);

}  // namespace evpose::server
