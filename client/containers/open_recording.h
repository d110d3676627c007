// SPDX-License-Identifier: Apache-2.0

// Recordings of all formats that the client reads (client/containers/README.md).
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "core/recordings/recording_reader.h"

namespace evpose::client {

struct OpenRecordingOptions {
  bool is_following = false;   // as in RecordingReaderOptions; only RAW and DAT files can be followed
  std::function<bool()> stop;  // as there
  // Size of the sensor for files that state none, from the user's camera.
  std::optional<SensorGeometry> geometry;
};

// Opens a recording and recognises its format by its content. `path` "-" is standard input, which may hold RAW, DAT,
// AEDAT or text. "FILE#topic" selects a topic of a ROS bag. The bytes of the reader are EVT3 as they are in the file,
// or FLAT64. Errors have the path, and a remedy: those of RecordingReader::Open(); INVALID_ARGUMENT for a damaged
// beginning, for a bag with several topics of events and for a topic that is none; UNIMPLEMENTED for a format that is
// recognised and not read.
absl::StatusOr<std::unique_ptr<RecordingReader>> OpenRecording(const std::string& path,
                                                               const OpenRecordingOptions& options = {});

}  // namespace evpose::client
