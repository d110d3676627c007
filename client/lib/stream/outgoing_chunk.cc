// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/outgoing_chunk.h"

#include <utility>

#include "core/base/byte_order.h"
#include "core/base/state_io.h"
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
  chunk.crc32c = Crc32c(AsBytes(payload));
  StateWriter both;
  both(point.digest, chunk.crc32c);
  const std::string bytes = both.Take();
  const uint32_t digest = Crc32c(AsBytes(bytes));
  chunk.end = {point.seq + 1, point.bytes + payload.size(), digest};
  chunk.payload = std::move(payload);
  return chunk;
}

}  // namespace evpose::client
