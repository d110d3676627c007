// SPDX-License-Identifier: Apache-2.0

// A store in the memory of the server: nothing outlives the process.
#pragma once

#include <cstdint>
#include <memory>

#include "server/stores/common/store.h"
#include "server/stores/memory/memory_sessions.h"

namespace evpose::server {

// `max_bytes` bounds the bytes of all sessions together. The caller bounds the bytes of the models.
std::unique_ptr<Store> MakeMemoryStore(uint64_t max_bytes = UINT64_MAX);
// A store on sessions that other stores share.
std::unique_ptr<Store> MakeMemoryStore(std::shared_ptr<MemorySessions> sessions);

}  // namespace evpose::server
