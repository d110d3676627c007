// SPDX-License-Identifier: Apache-2.0

// Writes events as files of any format that the client writes.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/events/event.h"

namespace evpose::client {

struct EventFileHeader {
  SensorGeometry geometry;
  int64_t time_offset_us = 0;      // see RecordingHeader
  int64_t metavision_zero_us = 0;  // likewise; HDF5 stores it if it is above 0
};

// A file appears under its name in Close(), or not at all.
class EventFileWriter {
 public:
  virtual ~EventFileWriter() = default;

  // Events and the triggers among them; a format without triggers leaves them out. Errors have the path: those of the
  // disk; INVALID_ARGUMENT for an event or trigger that the format cannot hold.
  virtual absl::Status Write(absl::Span<const Event> events, absl::Span<const evpose::Trigger> triggers) = 0;
  virtual absl::Status Close() = 0;
};

// Checks, without writing, whether a format can hold all events.
class EventFileChecker {
 public:
  virtual ~EventFileChecker() = default;

  // INVALID_ARGUMENT for an event or trigger that the format cannot hold, with its number.
  virtual absl::Status Check(absl::Span<const Event> events, absl::Span<const evpose::Trigger> triggers) = 0;
};

struct EventFileFormat {
  std::string_view name;    // for the command line: "raw"
  std::string_view suffix;  // suffix of file names: ".raw"
  std::string_view title;   // for users: "RAW EVT3"
  bool has_triggers;
  // Errors: INVALID_ARGUMENT for a sensor that the format cannot address.
  absl::StatusOr<std::unique_ptr<EventFileChecker>> (*check)(const EventFileHeader& header);
  absl::StatusOr<std::unique_ptr<EventFileWriter>> (*create)(const std::string& path, const EventFileHeader& header);
};

// All formats that can be written. A further one is a row of the table in event_file_writer.cc.
absl::Span<const EventFileFormat> EventFileFormats();

// The format called `name`, or, if that is empty, the one of the suffix of `path`. INVALID_ARGUMENT with all names if
// there is none.
absl::StatusOr<EventFileFormat> ChooseEventFileFormat(const std::string& name, const std::string& path);

}  // namespace evpose::client
