// SPDX-License-Identifier: Apache-2.0

// Decoders of the data of AEDAT recordings (client/containers/aedat/README.md). As those of core/events they never
// fail: they skip what they cannot interpret, and count it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "absl/types/span.h"
#include "client/containers/aedat/aedat_header.h"
#include "core/events/event.h"

namespace evpose::client {

// Counts since the construction of a decoder; the first two are in the output, the others are not.
struct AedatCounts {
  uint64_t cd_events = 0;
  uint64_t triggers = 0;
  uint64_t imu_samples = 0;      // AEDAT 2.0; later versions have them in packets of their own
  uint64_t image_samples = 0;    // AEDAT 2.0
  uint64_t other_records = 0;    // marks other than edges of a trigger input
  uint64_t other_packets = 0;    // packets of frames, inertial measurements and other cameras
  uint64_t outside_sensor = 0;   // events with an address beyond the sensor
  uint64_t invalid_events = 0;   // marked as invalid, or with a time that is negative or too large
  uint64_t damaged_packets = 0;  // packets that cannot be decoded
  // AEDAT 4.0: packets that are not read because their content has more than kMaxAedat4PacketBytes
  uint64_t oversized_packets = 0;
  uint64_t lost_bytes = 0;  // bytes of an unfinished record at the end, or after a damaged header of a packet

  friend bool operator==(const AedatCounts&, const AedatCounts&) = default;
};

class AedatDecoder {
 public:
  virtual ~AedatDecoder() = default;

  // Decodes the next bytes after the header, removes them from the front of `bytes` and appends the result to `out`.
  // Takes at least one byte, and all of them unless it has appended some 100,000 events: a few bytes of a compressed
  // packet may hold millions of events. The output does not depend on the cuts.
  virtual void Decode(absl::Span<const uint8_t>& bytes, DecodedEvents& out) = 0;

  // Counts what is unfinished at the end of the recording.
  virtual void Finish() = 0;

  const AedatCounts& counts() const { return counts_; }

 protected:
  // Appends the event, or counts it as outside the sensor. A `geometry` of zero contains all addresses.
  void Append(const Event& event, SensorGeometry geometry, DecodedEvents& out);

  AedatCounts counts_;
};

// AEDAT 2.0: records of an address and a time, big-endian. `layout` must be known.
std::unique_ptr<AedatDecoder> MakeAedat2Decoder(Aedat2Layout layout, SensorGeometry geometry);

// Guesses the layout from records, for a header without the name of a sensor: kDvs128 if all addresses have at most 16
// bits, otherwise kUnknown.
Aedat2Layout GuessAedat2Layout(absl::Span<const uint8_t> records);

// AEDAT 3.1: packets of records of one type, little-endian. Only those of the camera that sends the first polarity
// packet are taken.
std::unique_ptr<AedatDecoder> MakeAedat3Decoder(SensorGeometry geometry);

}  // namespace evpose::client
