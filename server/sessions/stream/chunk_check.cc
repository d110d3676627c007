// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/stream/chunk_check.h"

#include "absl/strings/str_cat.h"
#include "core/numerics/hash.h"
#include "server/runtime/errors.h"

namespace evpose::server {

bool IsKeepalive(const EventChunk& chunk) {
  return chunk.seq == 0 && chunk.payload.empty() && !chunk.discontinuity && !chunk.crc32c.has_value();
}

absl::Status CheckChunk(const EventChunk& chunk, Encoding encoding, uint32_t max_chunk_bytes) {
  if (chunk.seq == 0) return InvalidField("events.seq", "is 0 or missing; chunks are numbered from 1");
  const size_t num_bytes = chunk.payload.size();
  if (num_bytes > max_chunk_bytes) {
    return InvalidField("events.payload",
                        absl::StrCat("has ", num_bytes, " bytes; at most ", max_chunk_bytes, " go into one chunk"));
  }
  const int word = WordBytes(encoding);
  if (num_bytes % static_cast<size_t>(word) != 0) {
    return InvalidField("events.payload",
                        absl::StrCat("has ", num_bytes, " bytes, which is not whole ",
                                     std::string(EncodingName(encoding)), " words of ", word, " bytes"));
  }
  if (!chunk.crc32c.has_value()) return absl::OkStatus();
  if (*chunk.crc32c == Crc32c({reinterpret_cast<const uint8_t*>(chunk.payload.data()), num_bytes})) {
    return absl::OkStatus();
  }
  return WithReason(
      absl::DataLossError(
          absl::StrCat("chunk ", chunk.seq, ": the payload does not match its crc32c; attach again and send it again")),
      v1::CRC_MISMATCH, {{"seq", absl::StrCat(chunk.seq)}});
}

}  // namespace evpose::server
