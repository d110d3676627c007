// SPDX-License-Identifier: Apache-2.0

// A numbered chunk, with digests that distinguish it from another chunk of the same number.
#pragma once

#include <cstdint>
#include <string>

namespace evpose::client {

// A position between two chunks of a feed. Two feeds with equal points have sent the same bytes up to there.
struct FeedPoint {
  uint64_t seq = 0;     // number of the chunk before it; 0: the start
  uint64_t bytes = 0;   // payload up to it
  uint32_t digest = 0;  // CRC-32C over the previous digest and the chunk's own CRC-32C

  friend bool operator==(const FeedPoint&, const FeedPoint&) = default;
};

struct OutgoingChunk {
  FeedPoint end;               // the position after it; end.seq is its number
  bool discontinuity = false;  // bytes were lost before it
  uint32_t crc32c = 0;         // of the payload
  std::string payload;
};

// Returns the chunk after `point`.
OutgoingChunk MakeOutgoingChunk(const FeedPoint& point, std::string payload, bool discontinuity);

}  // namespace evpose::client
