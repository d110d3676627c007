// SPDX-License-Identifier: Apache-2.0

// A chunk on its way to the server: numbered, with what tells it from another of the same number.
#pragma once

#include <cstdint>
#include <string>

namespace evpose::client {

// A place between two chunks of a feed. Two feeds whose points are equal have sent the same bytes up to there.
struct FeedPoint {
  uint64_t seq = 0;     // of the chunk before it; 0: the beginning
  uint64_t bytes = 0;   // of payload up to it
  uint32_t digest = 0;  // CRC-32C over the digest before and the chunk's own CRC-32C

  friend bool operator==(const FeedPoint&, const FeedPoint&) = default;
};

struct OutgoingChunk {
  FeedPoint end;               // the place after it; end.seq is its number
  bool discontinuity = false;  // bytes were lost before it
  uint32_t crc32c = 0;         // of payload
  std::string payload;
};

// The chunk that follows `point`.
OutgoingChunk MakeOutgoingChunk(const FeedPoint& point, std::string payload, bool discontinuity);

}  // namespace evpose::client
