// Writes a RAW recording.
#pragma once

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
  static absl::StatusOr<std::unique_ptr<RecordingWriter>> Create(const std::string& path, Encoding encoding,
                                                                 SensorGeometry geometry);
  ~RecordingWriter();  // without Close(): removes the temporary file

  absl::Status Write(absl::Span<const Event> events);
  absl::Status Close();

 private:
  RecordingWriter();
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace evpose
