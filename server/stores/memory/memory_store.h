// SPDX-License-Identifier: Apache-2.0

// Everything in the server's own memory: nothing outlives the process.
#pragma once

#include <cstdint>
#include <memory>

#include "server/stores/common/store.h"

namespace evpose::server {

// `max_bytes` bounds what the sessions hand over; models are bounded by who puts them.
std::unique_ptr<Store> MakeMemoryStore(uint64_t max_bytes = UINT64_MAX);

}  // namespace evpose::server
