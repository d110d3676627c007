// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "server/rpc/server.h"

namespace evpose::server {

// The default of max_session_memory, bytes: 75 % of the memory that the process may take, or what the other limits of
// `options` leave of it, whichever is less. Those are the preparations of models, the model store, the memory of gRPC,
// and 0.2 GB for the rest of the process. At least a quarter of the memory, so that a small machine has sessions at
// all: its limits are then larger than its memory, but are hardly reached at the same time.
uint64_t DefaultSessionMemory(const ServerOptions& options, uint64_t available_bytes);

}  // namespace evpose::server
