// SPDX-License-Identifier: Apache-2.0

// A part of a recording as a RAW or DAT file in memory. Its words are copied from the recording.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "core/recordings/recording_reader.h"

namespace evpose::client {

struct SliceOptions {
  double start_s = 0.0;              // after the first time in the recording
  std::optional<double> duration_s;  // absent: to the end
  // Bounds of the slice, even if `duration_s` is longer: a report must be small enough to be sent, and it must not take
  // long to track the slice again.
  size_t max_bytes = size_t{32} << 20;
  double max_duration_s = 60.0;
};

struct RecordingSlice {
  // A RAW or DAT file. Sensor time = decoded time + `time_offset_us`, a field of the header of the file.
  std::string file;
  int64_t begin_us = 0;  // sensor times of the recording, to a millisecond
  int64_t end_us = 0;
  uint64_t data_bytes = 0;  // after the header
  bool is_cut = false;      // it ended at a bound of SliceOptions, before the requested end
};

// Reads a recording from its beginning to the end of the slice. A slice from the start begins with the first byte. A
// later slice begins at a time word: a decoder drops the events before the first complete time stamp, and the times of
// the slice lack whole periods of the clock of the encoding, which time_offset_us contains. Errors: those of
// RecordingReader::Read(); OUT_OF_RANGE if the recording has no data at that time.
absl::StatusOr<RecordingSlice> ReadSlice(RecordingReader& reader, const SliceOptions& options);

// Opens RecordingSlice::file. `file` must outlive the reader. Errors: those of ParseRecordingHeader().
absl::StatusOr<std::unique_ptr<RecordingReader>> OpenSlice(std::string_view file);

}  // namespace evpose::client
