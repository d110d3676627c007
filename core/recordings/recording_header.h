// SPDX-License-Identifier: Apache-2.0

// The ASCII header of Prophesee RAW and DAT files, in all its variants (core/recordings/README.md, section 1).
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "core/events/decoder.h"
#include "core/events/event.h"

namespace evpose {

struct RecordingHeader {
  Encoding encoding = Encoding::kEvt3;
  SensorGeometry geometry;          // as stated, of the named sensor, or the default
  bool geometry_is_stated = false;  // false: of the named sensor, or the default
  bool geometry_is_known = false;   // false: the default of the encoding
  size_t size_bytes = 0;            // offset of the first data byte
  std::string text;                 // as in the file, without the binary part
  // The format of a file that is neither RAW nor DAT ("CSV"); empty for these.
  std::string container;
  // Time on the recording's original clock at time 0 of the events, microseconds: where times since 1970 were shifted
  // to the first event, the time of that event.
  int64_t time_offset_us = 0;
  // The time of the events at which Metavision's clock is 0, where the container states it; else that is the time of
  // the first time word (FirstTimeWord).
  std::optional<int64_t> metavision_zero_us;
};

// Parses the header at the start of `prefix`; nullopt if the header may continue beyond `prefix` and `is_whole_file` is
// false. Errors: INVALID_ARGUMENT with the number (from 1) of a line that cannot be read or contradicts another one, or
// if no line states a format.
absl::StatusOr<std::optional<RecordingHeader>> ParseRecordingHeader(std::string_view prefix, bool is_whole_file);

// The header of a recording that this project writes: the lines of an EVK4 that readers need, and a line
// "% time_offset_us N" unless the offset is 0. For DAT also its two binary bytes.
std::string MakeRawHeader(Encoding encoding, SensorGeometry geometry, int64_t time_offset_us = 0);

}  // namespace evpose
