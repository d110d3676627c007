// SPDX-License-Identifier: Apache-2.0

// Checks of a chunk that need no state of the session.
#pragma once

#include <cstdint>

#include "absl/status/status.h"
#include "core/events/decoder.h"
#include "server/sessions/types/stream_data.h"

namespace evpose::server {

// Returns true for a chunk without any field, by which a client without events keeps its stream open. It is not part of
// the data of the session.
bool IsKeepalive(const EventChunk& chunk);

// Reads every byte of the payload if the chunk has a checksum. Errors: INVALID_ARGUMENT with the field (no number, too
// many bytes, an incomplete word), DATA_LOSS (CRC_MISMATCH).
absl::Status CheckChunk(const EventChunk& chunk, Encoding encoding, uint32_t max_chunk_bytes);

}  // namespace evpose::server
