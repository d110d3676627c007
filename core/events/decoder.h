// SPDX-License-Identifier: Apache-2.0

// Event streams to events. A decoder never fails: what it cannot read it skips, and what it skips it counts by kind.
// The rules, and where they depart from OpenEB on purpose, are in core/events/README.md.
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
  kFlat64,  // any other source: little-endian u64, t_us:32 | x:14 | y:14 | 0:3 | p:1 (t in the highest bits)
};

// "EVT3", "EVT2.1", "EVT2", "DAT", "FLAT64".
std::string_view EncodingName(Encoding encoding);
// 2, 8, 4, 8, 8.
int WordBytes(Encoding encoding);

// Counts since construction.
struct DecodeCounts {
  uint64_t cd_events = 0;
  uint64_t triggers = 0;
  uint64_t dropped_before_time = 0;     // events and triggers before the first time stamp (or, EVT3, the first row)
  uint64_t dropped_outside_sensor = 0;  // events whose row or column the sensor does not have
  uint64_t kept_outside_sensor = 0;     // the same, kept because OutsideSensor::kKeep asked for it
  uint64_t unknown_words = 0;           // reserved or unknown word types
  uint64_t broken_vectors = 0;          // vector words without a base, or triples that are not whole
  uint64_t time_backsteps = 0;          // times that stepped back without being a wrap of the clock
  uint64_t clock_wraps = 0;

  uint64_t dropped_events() const { return dropped_before_time + dropped_outside_sensor; }
  uint64_t invalid_words() const { return unknown_words + broken_vectors; }

  friend bool operator==(const DecodeCounts&, const DecodeCounts&) = default;
  static void VisitState(auto& archive, auto& self) {
    auto& [cd_events, triggers, before_time, outside, kept_outside, unknown, broken, backsteps, wraps] = self;
    archive(cd_events, triggers, before_time, outside, kept_outside, unknown, broken, backsteps, wraps);
  }
};

// What becomes of an event whose address lies outside the sensor but can be read.
enum class OutsideSensor {
  kDrop,  // every event that comes out can index an image of the sensor's size
  kKeep,  // as OpenEB does: for tools that report what a file holds; events may lie outside the geometry
};

class EventDecoder {
 public:
  virtual ~EventDecoder() = default;

  // Appends what `bytes` hold to `out`. State lives across calls, an unfinished word included: a stream cut at any
  // byte decodes to the same events.
  virtual void Decode(absl::Span<const uint8_t> bytes, DecodedEvents& out) = 0;

  // Bytes were lost: forgets the unfinished word and everything that a lost word may have changed, and waits for a
  // full time stamp. Counts and the count of clock wraps go on.
  virtual void ResetAfterLoss() = 0;

  // Bytes of an unfinished word or, EVT3, words of an unfinished vector triple that wait for the next call.
  virtual int pending_bytes() const = 0;

  const DecodeCounts& counts() const { return counts_; }

  // All that what comes next depends on, bit for bit: clock, counts, unfinished words. A state is loaded into a decoder
  // of the same encoding and geometry; after a failure (reader.status()) the decoder must not be used.
  virtual void SaveState(StateWriter& writer) const = 0;
  virtual void LoadState(StateReader& reader) = 0;

 protected:
  DecodeCounts counts_;
};

// Errors: INVALID_ARGUMENT for a geometry that is not positive or larger than the encoding can address.
absl::StatusOr<std::unique_ptr<EventDecoder>> MakeEventDecoder(Encoding encoding, SensorGeometry geometry,
                                                               OutsideSensor outside = OutsideSensor::kDrop);

// The largest geometry whose every pixel the encoding can address.
SensorGeometry AddressableGeometry(Encoding encoding);
// Errors: INVALID_ARGUMENT for a geometry that is not positive or larger than the encoding can address.
absl::Status ValidateGeometry(Encoding encoding, SensorGeometry geometry);

}  // namespace evpose
