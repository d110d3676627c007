// SPDX-License-Identifier: Apache-2.0

// A part of a recording as a RAW or DAT file in memory: its words are those of the recording.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "core/events/recording_reader.h"

namespace evpose::client {

struct SliceOptions {
  double start_s = 0.0;              // after the first time in the recording
  std::optional<double> duration_s;  // absent: to the end
  // Bounds of the slice, whatever the duration: the size of a report that can be sent, and the time that is needed to
  // track it again.
  size_t max_bytes = size_t{32} << 20;
  double max_duration_s = 60.0;
};

struct RecordingSlice {
  std::string file;      // with its header, in which time_offset_us says what its times leave out
  int64_t begin_us = 0;  // sensor times of the recording, to a millisecond
  int64_t end_us = 0;
  uint64_t data_bytes = 0;  // after the header
  bool is_cut = false;      // it ended at a bound, and not where the user or the recording ends it
};

// Reads a recording from its beginning to the end of the slice. A slice from the start begins with the first byte. A
// later one begins at a time word: events before the first complete time stamp are dropped by a decoder, and whole
// periods of the encoding's clock are not in its times (but in time_offset_us). Errors: those of
// RecordingReader::Read(); OUT_OF_RANGE if there are no data at that time.
absl::StatusOr<RecordingSlice> ReadSlice(RecordingReader& reader, const SliceOptions& options);

// Reads such a file. `file` must outlive the reader. Errors: those of ParseRecordingHeader().
absl::StatusOr<std::unique_ptr<RecordingReader>> OpenSlice(std::string_view file);

}  // namespace evpose::client
