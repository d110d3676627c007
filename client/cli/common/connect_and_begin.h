// SPDX-License-Identifier: Apache-2.0

// From an address to a session that takes events, through outages: what replay and stream share.
#pragma once

#include <functional>
#include <memory>

#include "absl/status/statusor.h"
#include "client/cli/common/command.h"
#include "client/cli/common/track_inputs.h"
#include "client/cli/common/track_run.h"
#include "client/lib/client.h"
#include "client/lib/retry.h"

namespace evpose::client {

struct BeginOptions {
  RetryOptions retry;  // of a server that goes away, though it was there
  // A server that was never there is waited for as one that went away; otherwise for --connect-timeout.
  bool waits_for_first_server = false;
  std::function<void(SessionConfig&)> complete = [](SessionConfig&) {};
};

// Connects to --server and calls run.Begin(), both again while that fails for want of a server, and says so: a server
// that ends between a model's upload and the session costs time, and nothing else. Errors: those of the last try;
// CANCELLED when it was interrupted while the server was away.
absl::StatusOr<std::unique_ptr<Client>> ConnectAndBegin(const BeginOptions& options, TrackRun& run,
                                                        const TrackArguments& arguments, const CliContext& context);

}  // namespace evpose::client
