// SPDX-License-Identifier: Apache-2.0

// Connects to a server and begins a session, with retries during outages; used by replay and stream.
#pragma once

#include <functional>
#include <memory>

#include "absl/status/statusor.h"
#include "client/cli/common/command.h"
#include "client/cli/common/run_inputs.h"
#include "client/cli/common/session_run.h"
#include "client/lib/stream/retry.h"
#include "evpose/client.h"

namespace evpose::client {

struct SessionStartOptions {
  RetryOptions retry;  // retries after a server has become unreachable
  // Whether the run continues a session. The first connection is then repeated as `retry` states; otherwise it is tried
  // for --connect-timeout.
  bool continues_session = false;
  // Called with the configuration before the session is created.
  std::function<void(SessionConfig&)> complete = [](SessionConfig&) {};
};

// Connects to --server and calls run.Begin(). Both are repeated, with messages to the user, while the server is
// unreachable: an outage between a model's upload and the creation of the session costs only time. Errors: that of the
// last attempt; CANCELLED after an interrupt while the server was unreachable.
absl::StatusOr<std::unique_ptr<Client>> StartSession(const SessionStartOptions& options, SessionRun& run,
                                                     const RunArguments& arguments, const CliContext& context);

}  // namespace evpose::client
