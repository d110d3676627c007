// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/outgoing_chunk.h"

#include <utility>

#include "core/numerics/hash.h"

namespace evpose::client {

OutgoingChunk MakeOutgoingReset(const FeedPoint& point, std::string message) {
  OutgoingChunk chunk = MakeOutgoingChunk(point, std::move(message), false);
  chunk.is_reset = true;
  chunk.end.bytes = point.bytes;
  return chunk;
}

OutgoingChunk MakeOutgoingChunk(const FeedPoint& point, std::string payload, bool discontinuity) {
  OutgoingChunk chunk;
  chunk.discontinuity = discontinuity;
  chunk.crc32c = Crc32c({reinterpret_cast<const uint8_t*>(payload.data()), payload.size()});
  uint8_t both[8];
  for (int i = 0; i < 4; ++i) {
    both[i] = static_cast<uint8_t>(point.digest >> (8 * i));
    both[4 + i] = static_cast<uint8_t>(chunk.crc32c >> (8 * i));
  }
  chunk.end = {point.seq + 1, point.bytes + payload.size(), Crc32c(both)};
  chunk.payload = std::move(payload);
  return chunk;
}

}  // namespace evpose::client
