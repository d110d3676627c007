// SPDX-License-Identifier: Apache-2.0

// The bytes of a recording: from a file, standard input, or a file that still grows; and their division into chunks.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/events/time_scanner.h"
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

// A piece of a recording that consists of whole words.
struct EventChunkBytes {
  std::vector<uint8_t> bytes;
  int64_t t_last_us = -1;     // unwrapped sensor time at its end; -1 before the first time word
  bool follows_loss = false;  // bytes were lost before it
};

struct ChunkerOptions {
  int64_t max_duration_us = 1000;         // sensor time after which a chunk ends: one pose period at 1 kHz
  size_t max_bytes = size_t{256} * 1024;  // size at which a chunk ends: a multiple of 8 (whole words of every encoding)

  // INVALID_ARGUMENT with the name of the invalid field.
  absl::Status Validate() const;
};

// Cuts a recording into chunks of whole words that end by sensor time or size, whichever comes first. Interprets the
// time words only and leaves the bytes unchanged. The cuts depend on the recording and the options, not on the sizes of
// the reads. The time word that ends a chunk is its last word, so that the receiver of a live stream learns of the time
// without delay. Where bytes were lost a chunk ends, and the unfinished word before the loss is discarded.
class Chunker {
 public:
  Chunker(RecordingReader& reader, const ChunkerOptions& options);
  Chunker(const Chunker&) = delete;  // two would read from one reader
  Chunker& operator=(const Chunker&) = delete;

  // The next chunk; one without bytes at the end. An unfinished word at the end of the stream is not returned but
  // counted by truncated_bytes(). Errors: those of ChunkerOptions::Validate() and RecordingReader::Read().
  absl::StatusOr<EventChunkBytes> Next();
  size_t truncated_bytes() const { return at_end_ ? end_ - begin_ : 0; }

 private:
  // Moves whole words from the buffer to the chunk; true if they complete it.
  bool TakeWords(EventChunkBytes& chunk);
  // Reads more bytes into the buffer; false at the end.
  absl::StatusOr<bool> Refill();

  RecordingReader& reader_;
  const ChunkerOptions options_;
  const size_t word_bytes_;
  TimeScanner scanner_;
  std::vector<uint8_t> buffer_;
  size_t begin_ = 0;  // of the bytes that belong to no chunk yet
  size_t end_ = 0;
  bool at_end_ = false;
  bool loss_is_due_ = false;  // the next chunk follows a loss
};

}  // namespace evpose
