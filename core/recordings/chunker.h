// SPDX-License-Identifier: Apache-2.0

// The division of a recording into chunks of whole words.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/events/time_scanner.h"
#include "core/recordings/recording_reader.h"

namespace evpose {

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
  size_t truncated_bytes() const { return is_at_end_ ? end_ - begin_ : 0; }

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
  bool is_at_end_ = false;
  bool loss_is_due_ = false;  // the next chunk follows a loss
};

}  // namespace evpose
