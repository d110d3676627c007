// SPDX-License-Identifier: Apache-2.0

// Calls to a server that may be away for a while.
#pragma once

#include <functional>
#include <stop_token>

#include "absl/status/status.h"

namespace evpose::client {

// Repeats `call` until it returns OK or an error that another attempt cannot change, and returns the last status. The
// delays between two attempts grow. `on_error` receives the status before each delay. Returns early after a request of
// `stop`, which must also cancel the call.
absl::Status RepeatCall(const std::stop_token& stop, const std::function<absl::Status()>& call,
                        const std::function<void(const absl::Status&)>& on_error);

}  // namespace evpose::client
