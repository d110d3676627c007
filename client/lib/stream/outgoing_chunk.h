// SPDX-License-Identifier: Apache-2.0

// A numbered chunk, with digests that distinguish it from another chunk of the same number.
#pragma once

#include <cstdint>
#include <string>

#include "evpose/track.h"

namespace evpose::client {

// The longest word of an encoding: a multiple of it is whole words of every encoding.
inline constexpr uint64_t kWordBytes = 8;

// A chunk of events, or a reset.
struct OutgoingChunk {
  FeedPoint end;               // the position after it; end.seq is its number
  bool discontinuity = false;  // bytes were lost before it
  uint32_t crc32c = 0;         // checksum of the payload
  std::string payload;         // events; for a reset the message v1::TrackRequest::ResetPose without its number
  bool is_reset = false;       // a reset has no bytes in FeedPoint::bytes
};

// Return the chunk or the reset after `point`.
OutgoingChunk MakeOutgoingChunk(const FeedPoint& point, std::string payload, bool discontinuity);
OutgoingChunk MakeOutgoingReset(const FeedPoint& point, std::string message);

}  // namespace evpose::client
