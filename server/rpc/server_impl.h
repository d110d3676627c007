// Server with the trackers that its sessions use given from outside: for tests.
#pragma once

#include <memory>

#include "absl/status/statusor.h"
#include "server/rpc/server.h"
#include "server/sessions/session_config.h"

namespace evpose::server {

absl::StatusOr<std::unique_ptr<Server>> StartServer(const ServerOptions& options, TrackerFactory make_tracker);

}  // namespace evpose::server
