// Everything in the server's own memory: nothing outlives the process.
#pragma once

#include <cstddef>
#include <memory>

#include "server/stores/store.h"

namespace evpose::server {

// Each pose log keeps the last `pose_log_capacity` poses, at least 1.
std::unique_ptr<Store> MakeMemoryStore(size_t pose_log_capacity);

}  // namespace evpose::server
