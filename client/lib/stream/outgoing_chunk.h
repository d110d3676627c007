// SPDX-License-Identifier: Apache-2.0

// A numbered chunk, with digests that distinguish it from another chunk of the same number.
#pragma once

#include <cstdint>
#include <string>

#include "evpose/track.h"

namespace evpose::client {

struct OutgoingChunk {
  FeedPoint end;               // the position after it; end.seq is its number
  bool discontinuity = false;  // bytes were lost before it
  uint32_t crc32c = 0;         // of the payload
  std::string payload;
};

// Returns the chunk after `point`.
OutgoingChunk MakeOutgoingChunk(const FeedPoint& point, std::string payload, bool discontinuity);

}  // namespace evpose::client
