// SPDX-License-Identifier: Apache-2.0

// Calls to a server that may be away for a while.
#pragma once

#include <functional>
#include <stop_token>

#include "absl/status/status.h"

namespace evpose::client {

// Makes `call` until it returns OK or an error that another attempt cannot change, with growing delays between two
// attempts, and returns its last status. `on_error` gets the status before each delay. Returns early after a request of
// `stop`, which must also end the call.
absl::Status RepeatCall(const std::stop_token& stop, const std::function<absl::Status()>& call,
                        const std::function<void(const absl::Status&)>& on_error);

}  // namespace evpose::client
