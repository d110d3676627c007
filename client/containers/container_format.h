// SPDX-License-Identifier: Apache-2.0

// The formats of recordings other than RAW and DAT: how their files are recognised and opened.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "core/events/event.h"
#include "core/recordings/byte_source.h"
#include "core/recordings/recording_reader.h"

namespace evpose::client {

// A file whose format has been recognised.
struct ContainerFile {
  std::string name;   // for errors
  std::string path;   // empty for a stream: standard input, a pipe
  std::string topic;  // topic of FILE#topic; empty if none was given
  // The bytes from the beginning; the only ones that can be read of a stream. A reader that opens `path` itself
  // destroys it.
  std::unique_ptr<ByteSource> bytes;
  std::optional<SensorGeometry> geometry;  // size of the sensor of the caller's camera, for files that state none
};

struct ContainerFormat {
  std::string_view name;  // name of the format, for errors
  // Whether the file that begins with `prefix` has this format; `prefix` has up to kSniffedBytes bytes, or kStreamBytes
  // of a stream.
  bool (*matches)(std::string_view prefix);
  // Errors name the file.
  absl::StatusOr<std::unique_ptr<RecordingReader>> (*open)(ContainerFile file);
  bool reads_streams = false;  // opens files without a path
  bool has_topics = false;
};

// Bytes from which the format is found: longer than the headers of nearly all recordings.
inline constexpr size_t kSniffedBytes = size_t{64} * 1024;
inline constexpr size_t kStreamBytes = 4096;  // fewer, because a live stream begins only when it has sent them

}  // namespace evpose::client
