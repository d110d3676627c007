// SPDX-License-Identifier: Apache-2.0

// Writes a RAW recording.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/events/encoder.h"

namespace evpose {

// Writes to a temporary name beside `path` and renames it in Close(): nothing half-written is left under the name.
class RecordingWriter {
 public:
  // Errors name the path: NOT_FOUND for a missing directory, PERMISSION_DENIED, INVALID_ARGUMENT for a directory or a
  // geometry that the encoding cannot address, UNIMPLEMENTED for DAT.
  static absl::StatusOr<std::unique_ptr<RecordingWriter>> Create(const std::string& path, Encoding encoding,
                                                                 SensorGeometry geometry);
  ~RecordingWriter();  // without Close(): removes the temporary file

  // EventEncoder::Encode() and EncodeTime(); errors name the path. After an error nothing of the call is written.
  absl::Status Write(absl::Span<const Event> events);
  absl::Status WriteTime(int64_t t_us);
  // Once, last. Errors: what could not be written, a full disk above all; then no file is left under the name.
  absl::Status Close();

 private:
  RecordingWriter();
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace evpose
