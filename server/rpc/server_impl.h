// SPDX-License-Identifier: Apache-2.0

// Starting a server with a given factory of trackers and a given store, for tests.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "server/rpc/server.h"
#include "server/sessions/types/session_config.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// `store` replaces the store of `options`; null: that one is opened.
absl::StatusOr<std::unique_ptr<Server>> StartServer(const ServerOptions& options, TrackerFactory make_tracker,
                                                    std::unique_ptr<Store> store = nullptr);

}  // namespace evpose::server
