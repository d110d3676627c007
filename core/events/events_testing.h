// SPDX-License-Identifier: Apache-2.0

// Helpers of the tests of this folder.
#pragma once

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "core/base/temporary_directory_testing.h"
#include "core/events/decoder.h"
#include "core/numerics/random.h"

namespace evpose {

inline constexpr SensorGeometry kVga = {640, 480};

template <typename Word>
std::vector<uint8_t> BytesOf(const std::vector<Word>& words) {
  std::vector<uint8_t> bytes(words.size() * sizeof(Word));
  if (!words.empty()) std::memcpy(bytes.data(), words.data(), bytes.size());
  return bytes;
}

inline uint16_t Evt3(uint32_t type, uint32_t content) { return static_cast<uint16_t>(type << 12 | content); }
inline uint32_t Evt2(uint32_t type, uint32_t content) { return type << 28 | content; }
inline uint32_t Evt2Cd(uint32_t polarity, uint32_t low, uint32_t x, uint32_t y) {
  return polarity << 28 | low << 22 | x << 11 | y;
}

struct Decoded {
  DecodedEvents out;
  DecodeCounts counts;
  int pending_bytes = 0;
};

// Decodes the pieces that end at `cuts`, and the rest.
inline Decoded DecodeInPieces(Encoding encoding, SensorGeometry geometry, OutsideSensor outside,
                              absl::Span<const uint8_t> bytes, const std::vector<size_t>& cuts) {
  Decoded result;
  const std::unique_ptr<EventDecoder> decoder = MakeEventDecoder(encoding, geometry, outside).value();
  size_t begin = 0;
  for (const size_t end : cuts) {
    decoder->Decode(bytes.subspan(begin, end - begin), result.out);
    begin = end;
  }
  decoder->Decode(bytes.subspan(begin), result.out);
  result.counts = decoder->counts();
  result.pending_bytes = decoder->pending_bytes();
  return result;
}

inline Decoded DecodeAll(Encoding encoding, SensorGeometry geometry, absl::Span<const uint8_t> bytes) {
  return DecodeInPieces(encoding, geometry, OutsideSensor::kDrop, bytes, {});
}

inline bool SameDecoded(const Decoded& a, const Decoded& b) {
  return a.out.events == b.out.events && a.out.triggers == b.out.triggers && a.out.time_marks == b.out.time_marks &&
         a.counts == b.counts && a.pending_bytes == b.pending_bytes;
}

// Increasing random positions, at most `max_piece` apart.
inline std::vector<size_t> RandomCuts(size_t size, size_t max_piece, uint64_t seed) {
  Random random(seed);
  std::vector<size_t> cuts;
  for (size_t at = random.UniformInt(max_piece); at < size; at += 1 + random.UniformInt(max_piece)) cuts.push_back(at);
  return cuts;
}

}  // namespace evpose
