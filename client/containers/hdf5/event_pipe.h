// SPDX-License-Identifier: Apache-2.0

// The records by which evpose and evpose-hdf5 exchange a recording (client/containers/hdf5/README.md, section 2).
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/events/event.h"

namespace evpose::client {

struct PipeHeader {
  std::string format;          // "Metavision HDF5 (ECF)"
  SensorGeometry geometry;     // zero if the file does not state it
  int64_t time_offset_us = 0;  // RecordingHeader::time_offset_us
  // The time at which Metavision's clock is 0, at least 0; -1 if Metavision does not read the format.
  int64_t metavision_zero_us = -1;

  friend bool operator==(const PipeHeader&, const PipeHeader&) = default;
};

// Numbers of events and triggers that were lost in a damaged file, up to now.
struct PipeLosses {
  uint64_t events = 0;    // in chunks that cannot be read
  uint64_t triggers = 0;  // likewise
  uint64_t invalid = 0;   // events and triggers with a time below 0, or beyond the range

  friend bool operator==(const PipeLosses&, const PipeLosses&) = default;
};

enum class PipeRecordKind : uint8_t { kHeader = 1, kEvents = 2, kTriggers = 3, kLosses = 4, kEnd = 5 };

// The members of other kinds are left unchanged.
struct PipeRecord {
  PipeRecordKind kind = PipeRecordKind::kEnd;
  PipeHeader header;
  std::vector<Event> events;
  std::vector<Trigger> triggers;
  PipeLosses losses;
};

// Append records to `out`. At most kMaxPipeElements events or triggers.
inline constexpr size_t kMaxPipeElements = 65536;
void AppendPipeHeader(const PipeHeader& header, std::vector<uint8_t>& out);
void AppendPipeEvents(absl::Span<const Event> events, std::vector<uint8_t>& out);
void AppendPipeTriggers(absl::Span<const Trigger> triggers, std::vector<uint8_t>& out);
void AppendPipeLosses(const PipeLosses& losses, std::vector<uint8_t>& out);
void AppendPipeEnd(std::vector<uint8_t>& out);

// Takes a record from the front of `bytes`; false, without taking anything, if it is incomplete. Errors: DATA_LOSS for
// bytes that are no record.
absl::StatusOr<bool> TakePipeRecord(absl::Span<const uint8_t>& bytes, PipeRecord& record);

}  // namespace evpose::client
