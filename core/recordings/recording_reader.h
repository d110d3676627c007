// SPDX-License-Identifier: Apache-2.0

// The bytes of a recording: from a file, standard input, or a file that still grows.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/recordings/byte_source.h"
#include "core/recordings/recording_header.h"

namespace evpose {

// Parts of a recording that its reader left out, of one kind.
struct SkippedParts {
  enum class Loss {
    kEvents,  // each part is an event that is missing, or may have been one
    kPieces,  // each part may have held any number of events
    kNone,    // the parts are no events of this camera
  };
  std::string what;  // in the plural: "lines that cannot be read"
  uint64_t count = 0;
  Loss loss = Loss::kPieces;
};

class RecordingReader {
 public:
  // Opens a recording and reads its header; `path` "-" is standard input. With `follow` it returns before the first
  // event. Errors have the path: NOT_FOUND, PERMISSION_DENIED, INVALID_ARGUMENT for a directory, an empty or
  // header-only file or an invalid header (with its line); CANCELLED if `stop` ended the wait for the rest of the
  // header.
  static absl::StatusOr<std::unique_ptr<RecordingReader>> Open(const std::string& path,
                                                               const RecordingReaderOptions& options = {});
  // The same for bytes of which nothing has been read yet.
  static absl::StatusOr<std::unique_ptr<RecordingReader>> FromBytes(std::unique_ptr<ByteSource> source);
  virtual ~RecordingReader() = default;

  virtual const RecordingHeader& header() const = 0;

  // Fills `buffer` with the next bytes after the header and returns their number, which may be smaller than the buffer;
  // 0 at the end. Errors: DATA_LOSS if the file shrank, or without `follow` if it changed or was replaced while it was
  // read; UNAVAILABLE with path and offset if reading fails.
  virtual absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) = 0;

  // Size of the data after the header; -1 if unknown (standard input, a growing file).
  virtual int64_t data_size_bytes() const = 0;

  // Whether bytes were lost just before those of the last Read(), so that a decoder has to wait for a full time stamp.
  virtual bool follows_loss() const { return false; }

  // What was left out so far: the damaged parts, and those that are not events. RAW and DAT leave out nothing.
  virtual std::vector<SkippedParts> skipped() const { return {}; }
};

}  // namespace evpose
