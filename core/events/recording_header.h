// SPDX-License-Identifier: Apache-2.0

// The ASCII header of Prophesee RAW and DAT files, in every shape that cameras and tools have written.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "core/events/decoder.h"
#include "core/events/event.h"

namespace evpose {

struct RecordingHeader {
  Encoding encoding = Encoding::kEvt3;
  SensorGeometry geometry;          // from the header, or the sensor that its plugin name stands for
  bool geometry_is_stated = false;  // false: taken from the plugin name or a default for the encoding
  bool geometry_is_known = false;   // stated, or that of the sensor that the header names; false: the default
  size_t size_bytes = 0;            // offset of the first data byte
  std::string text;                 // as in the file, without the binary part
};

// Parses the header at the start of `prefix`. Errors: INVALID_ARGUMENT naming the line (1-based) that contradicts
// another or cannot be read, or saying that no line names a format.
// nullopt when the header may go on beyond `prefix` and `is_whole_file` is false.
absl::StatusOr<std::optional<RecordingHeader>> ParseRecordingHeader(std::string_view prefix, bool is_whole_file);

// A header as an EVK4 writes it.
std::string MakeRawHeader(Encoding encoding, SensorGeometry geometry);

}  // namespace evpose
