// SPDX-License-Identifier: Apache-2.0

// Writes RAW and DAT recordings.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/base/output_file.h"
#include "core/events/encoder.h"

namespace evpose {

// Writes to a temporary name beside `path` and renames it in Close(): no incomplete recording appears under `path`.
// The destructor removes the temporary file unless Close() succeeded.
class RecordingWriter {
 public:
  // Errors have the path: NOT_FOUND for a missing directory, PERMISSION_DENIED, INVALID_ARGUMENT for a directory or a
  // geometry that the encoding cannot address. `time_offset_us`: see RecordingHeader.
  static absl::StatusOr<std::unique_ptr<RecordingWriter>> Create(const std::string& path, Encoding encoding,
                                                                 SensorGeometry geometry, int64_t time_offset_us = 0);
  // EventEncoder::Encode() and EncodeTrigger(), with the path in errors. A call with an error writes nothing.
  absl::Status Write(absl::Span<const Event> events);
  absl::Status WriteTrigger(const Trigger& trigger);
  // Completes the file; the last call. Errors: delayed write errors, a full disk in particular; then there is no file
  // under `path`.
  absl::Status Close();

 private:
  RecordingWriter(std::string path, OutputFile file, std::unique_ptr<EventEncoder> encoder)
      : path_(std::move(path)), file_(std::move(file)), encoder_(std::move(encoder)) {}

  absl::Status CheckOpen() const;
  // Appends the encoded bytes unless encoding failed.
  absl::Status Flush(const absl::Status& encoded);

  const std::string path_;
  OutputFile file_;
  const std::unique_ptr<EventEncoder> encoder_;
  std::vector<uint8_t> bytes_;
  bool is_closed_ = false;
};

}  // namespace evpose
