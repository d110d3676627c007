// SPDX-License-Identifier: Apache-2.0

// The events of a file that stores each event by itself: text, arrays, messages with events.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/events/event.h"
#include "core/recordings/recording_reader.h"

namespace evpose::client {

// An event as a file stores it, or an edge of a trigger input among them. Its numbers may lie outside what an Event can
// hold: MakeSourceReader() checks them.
struct SourceEvent {
  int64_t t_us = 0;  // on the file's clock
  int64_t x = 0;     // column, 0 at the left
  int64_t y = 0;     // row, 0 at the top
  bool is_on = false;
  int trigger_input = -1;  // at least 0 for a trigger, of which `is_on` is a rising edge; x and y have no meaning then
};

// Appends events and triggers, each trigger before the first of the remaining events at its time or later.
void AppendMerged(absl::Span<const Event> events, absl::Span<const Trigger> triggers, std::vector<SourceEvent>& out);

// Bytes that a source reads at a time: the cost of a call is then small against that of decoding, and the memory stays
// small.
inline constexpr size_t kReadBytes = size_t{256} * 1024;

struct SourceFacts {
  std::string format;                      // the name of the format: "CSV"
  std::optional<SensorGeometry> geometry;  // as the file states it
  int64_t time_offset_us = 0;              // as the file states it: see RecordingHeader
  // The time on the file's clock at which Metavision's clock is 0; nullopt if Metavision does not read the format.
  std::optional<int64_t> metavision_zero_us;
};

class EventSource {
 public:
  virtual ~EventSource() = default;

  virtual const SourceFacts& facts() const = 0;

  // Replaces the contents of `events` with the next events, in the order of the file. A call may yield no event;
  // usually it yields at most some 100,000 events, and up to 5 million from a message or a packet of 64 MiB. Returns
  // false at the end. A damaged part is skipped and counted. Errors: those of RecordingReader::Read().
  virtual absl::StatusOr<bool> Next(std::vector<SourceEvent>& events) = 0;

  // The parts that Next() has left out so far.
  virtual std::vector<SkippedParts> skipped() const = 0;
};

// Makes a source from its beginning; called once more if the size of the sensor has to be found.
using SourceOpener = std::function<absl::StatusOr<std::unique_ptr<EventSource>>()>;

// A recording with the events of a source as FLAT64.
//
// Times: if the first event's time fits the clock of FLAT64 (32 bits of microseconds), the times are those of the file.
// Otherwise, as for times since 1970, they are relative to the first event, and the header's time_offset_us is the time
// of that event.
// Order: that of the file; steps back in time remain, because all consumers of events accept them. An event that FLAT64
// cannot hold is left out and counted. Its time is negative, is not a number or differs from that of the previous event
// by more than 35 minutes (half the clock's range), or its row or column is negative or above 16383. Triggers are words
// of FLAT64. If the times of a recording are shifted, the triggers before the first event are left out and counted.
// Sensor: the size that the file states; else `geometry`, that of the caller's camera; else, if `can_reopen`, that of
// the smallest known sensor that contains all events, for which all events are read once; else 2048 x 2048. In the
// latter two cases the header's geometry_is_stated and geometry_is_known are false. Errors: those of `open` and of
// EventSource::Next(); INVALID_ARGUMENT with `name` if there is no event, or none among the first millions of triggers.
absl::StatusOr<std::unique_ptr<RecordingReader>> MakeSourceReader(const std::string& name, const SourceOpener& open,
                                                                  std::optional<SensorGeometry> geometry,
                                                                  bool can_reopen);

}  // namespace evpose::client
