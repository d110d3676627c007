// SPDX-License-Identifier: Apache-2.0

// For tests of AEDAT decoders: decoding in pieces, and the digest of shared data's list of expected results.
#pragma once

#include <algorithm>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "client/containers/aedat/aedat_decoder.h"
#include "core/events/event.h"
#include "core/recordings/event_digest.h"

namespace evpose::client {

struct DecodedAedat {
  std::vector<Event> events;
  std::vector<Trigger> triggers;
  AedatCounts counts;

  friend bool operator==(const DecodedAedat&, const DecodedAedat&) = default;
};

inline DecodedAedat DecodeInPieces(const std::function<std::unique_ptr<AedatDecoder>()>& make,
                                   absl::Span<const uint8_t> bytes, size_t piece_bytes) {
  const std::unique_ptr<AedatDecoder> decoder = make();
  DecodedEvents out;
  while (!bytes.empty()) {
    absl::Span<const uint8_t> piece = bytes.first(std::min(piece_bytes, bytes.size()));
    bytes.remove_prefix(piece.size());
    while (!piece.empty()) decoder->Decode(piece, out);
  }
  decoder->Finish();
  return {{out.events.begin(), out.events.end()}, out.triggers, decoder->counts()};
}

inline std::string Sha256OfEvents(absl::Span<const Event> events) {
  EventDigest digest;
  digest.Add(events);
  return digest.FinishHex();
}

}  // namespace evpose::client
