// SPDX-License-Identifier: Apache-2.0

// Checks of a chunk that need no state of the session.
#pragma once

#include <cstdint>

#include "absl/status/status.h"
#include "core/events/decoder.h"
#include "server/sessions/types/stream_data.h"

namespace evpose::server {

// True for a chunk without any field: the client is alive and has no events. It is not part of the session's data.
bool IsSignOfLife(const EventChunk& chunk);

// Reads every byte of the payload when it has a checksum. Errors: INVALID_ARGUMENT with the field (no number, too many
// bytes, a word that is cut), DATA_LOSS (CRC_MISMATCH).
absl::Status CheckChunk(const EventChunk& chunk, Encoding encoding, uint32_t max_chunk_bytes);

}  // namespace evpose::server
