// SPDX-License-Identifier: Apache-2.0

// Decoders of event streams. A decoder never fails: it skips the words that it cannot interpret, and counts them by
// kind. Formats, rules and intended departures from OpenEB are in core/events/README.md.
#pragma once

#include <cstdint>
#include <memory>
#include <string_view>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/base/state_io.h"
#include "core/events/event.h"

namespace evpose {

enum class Encoding {
  kEvt3,    // Prophesee EVT 3.0: 16-bit little-endian words
  kEvt21,   // Prophesee EVT 2.1: 64-bit words
  kEvt2,    // Prophesee EVT 2.0: 32-bit words
  kDat,     // Prophesee DAT, 2D events of 8 bytes (after the file's two binary header bytes)
  kFlat64,  // other sources: 64-bit words, from the highest bit t_us:32 | x:14 | y:14 | 0:2 | trigger:1 | p:1
};

inline constexpr size_t kNumEncodings = static_cast<size_t>(Encoding::kFlat64) + 1;

// The name for users: "EVT3", "EVT2.1", "EVT2", "DAT" or "FLAT64".
std::string_view EncodingName(Encoding encoding);
// Bytes of a word: 2, 8, 4, 8 and 8.
int WordBytes(Encoding encoding);

// Counts since the construction of the decoder.
struct DecodeCounts {
  uint64_t cd_events = 0;
  uint64_t triggers = 0;
  uint64_t dropped_before_time = 0;     // events and triggers before the first time stamp (or, EVT3, the first row)
  uint64_t dropped_outside_sensor = 0;  // events with a row or column outside the sensor
  uint64_t kept_outside_sensor = 0;     // the same, kept with OutsideSensor::kKeep
  uint64_t unknown_words = 0;           // reserved or unknown word types
  uint64_t broken_vectors = 0;          // vector words without a base, and incomplete triples
  uint64_t time_backsteps = 0;          // times that stepped back, wraps of the clock excepted
  uint64_t clock_wraps = 0;
  uint64_t padding_words = 0;  // EVT3 0x9999, with which cameras fill buffers

  uint64_t dropped_events() const { return dropped_before_time + dropped_outside_sensor; }
  uint64_t invalid_words() const { return unknown_words + broken_vectors; }

  friend bool operator==(const DecodeCounts&, const DecodeCounts&) = default;
  static void VisitState(auto& archive, auto& self) {
    auto& [cd_events, triggers, before_time, outside, kept_outside, unknown, broken, backsteps, wraps, padding] = self;
    // Padding words, which were not counted at first, follow in the state of the EVT3 decoder.
    archive(cd_events, triggers, before_time, outside, kept_outside, unknown, broken, backsteps, wraps);
  }
};

// Treatment of an event with a readable address outside the sensor.
enum class OutsideSensor {
  kDrop,  // every event in the output can index an image of the sensor's size
  kKeep,  // as OpenEB: for tools that report the content of a file; events may lie outside the geometry
};

class EventDecoder {
 public:
  virtual ~EventDecoder() = default;

  // Decodes `bytes` and appends the result to `out`. The state, an unfinished word included, continues across calls: a
  // stream cut at any byte decodes to the same events.
  virtual void Decode(absl::Span<const uint8_t> bytes, DecodedEvents& out) = 0;

  // To be called when bytes were lost: discards the unfinished word and all state that a lost word may have changed,
  // and waits for a full time stamp. Counts and clock wraps continue.
  virtual void ResetAfterLoss() = 0;

  // Bytes of an unfinished word (EVT3: also of an unfinished vector triple) that wait for the next call.
  virtual int pending_bytes() const = 0;

  const DecodeCounts& counts() const { return counts_; }

  // The complete state: clock, counts, unfinished words. A decoder of the same encoding and geometry that loads it
  // continues with the same bits; after a failure (reader.status()) it must not be used.
  virtual void SaveState(StateWriter& writer) const = 0;
  virtual void LoadState(StateReader& reader) = 0;

 protected:
  DecodeCounts counts_;
};

// Creates a decoder. Errors: those of ValidateGeometry().
absl::StatusOr<std::unique_ptr<EventDecoder>> MakeEventDecoder(Encoding encoding, SensorGeometry geometry,
                                                               OutsideSensor outside = OutsideSensor::kDrop);

// Errors: INVALID_ARGUMENT for a geometry that is not positive or larger than the encoding can address.
absl::Status ValidateGeometry(Encoding encoding, SensorGeometry geometry);

}  // namespace evpose
