// SPDX-License-Identifier: Apache-2.0

// Reads recordings for tests.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/events/decoder.h"
#include "core/recordings/recording_reader.h"

namespace evpose {

// Returns all events of a recording. The file must exist and be valid.
inline std::vector<Event> EventsOf(const std::string& path) {
  const auto reader = RecordingReader::Open(path).value();
  const auto decoder = MakeEventDecoder(reader->header().encoding, reader->header().geometry).value();
  DecodedEvents decoded;
  std::vector<uint8_t> buffer(1 << 16);
  while (const size_t size = reader->Read(absl::MakeSpan(buffer)).value()) {
    decoder->Decode(absl::MakeConstSpan(buffer).subspan(0, size), decoded);
  }
  return {decoded.events.begin(), decoded.events.end()};
}

}  // namespace evpose
