// SPDX-License-Identifier: Apache-2.0

// Checks that the process may create the threads that it needs.
#pragma once

#include "absl/status/status.h"

namespace evpose::server {

// Creates `num_threads` threads at the same time and ends them. boost::asio::thread_pool waits for ever when it cannot
// create its threads, and gRPC aborts the process. Errors: RESOURCE_EXHAUSTED with the number that could be created.
absl::Status CheckThreadsCanBeMade(int num_threads);

}  // namespace evpose::server
