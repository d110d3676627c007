// SPDX-License-Identifier: Apache-2.0

// The camera's bytes as they are: from a file, from standard input, from a file that still grows.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/events/recording_header.h"

namespace evpose {

struct RecordingReaderOptions {
  // Keep reading at the end of the file as it grows, until `stop` says so. A pipe ends when its writer closes it.
  bool follow = false;
  // Asked before every wait, some 100 times a second while nothing comes; true ends the reading cleanly.
  std::function<bool()> stop;
};

class RecordingReader {
 public:
  // `path` "-" is standard input. Errors, each naming the path: NOT_FOUND, PERMISSION_DENIED, INVALID_ARGUMENT for
  // a directory, an empty or header-only file, a header that contradicts itself or names no format (with its line);
  // CANCELLED when `stop` ended the wait for a header that still grows. While following, the first event is not waited
  // for.
  static absl::StatusOr<std::unique_ptr<RecordingReader>> Open(const std::string& path,
                                                               const RecordingReaderOptions& options = {});
  // The same from an open descriptor (a pipe, a socket), which the reader closes; `name` stands for the path in errors.
  static absl::StatusOr<std::unique_ptr<RecordingReader>> OpenDescriptor(int descriptor, const std::string& name,
                                                                         const RecordingReaderOptions& options = {});
  virtual ~RecordingReader() = default;

  virtual const RecordingHeader& header() const = 0;

  // Fills `buffer` with the next bytes after the header; returns how many, 0 at the end. May return fewer than asked
  // while a stream is live. Errors: DATA_LOSS or UNAVAILABLE naming path and offset when reading fails.
  virtual absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) = 0;

  // Size of the data after the header, or -1 when unknown (standard input, a growing file).
  virtual int64_t data_size_bytes() const = 0;
};

// A piece of a recording that is whole words.
struct EventChunkBytes {
  std::vector<uint8_t> bytes;
  int64_t t_last_us = -1;  // the latest sensor time in it or before it, clock unwrapped; -1 when none was seen yet
};

struct ChunkerOptions {
  int64_t max_duration_us = 1000;  // closed after this much sensor time: one pose period at 1 kHz
  size_t max_bytes = 256 * 1024;   // closed at this size; a multiple of 8, at least 8

  // INVALID_ARGUMENT naming the field that is wrong.
  absl::Status Validate() const;
};

// Cuts a recording into chunks of whole words, closed by sensor time or size, whichever comes first. Reads the time
// words only; the bytes pass through as they are. Where the cuts are depends on the recording and the options, not on
// how many bytes each read brings. The time word that closes a chunk is its last, so that a live reader is told of the
// time as soon as the camera tells it.
class Chunker {
 public:
  Chunker(RecordingReader& reader, const ChunkerOptions& options);
  ~Chunker();

  // The next chunk; empty bytes at the end. Errors: those of ChunkerOptions::Validate() and RecordingReader::Read().
  // What remains of a word at the end of the stream is not returned but counted by truncated_bytes().
  absl::StatusOr<EventChunkBytes> Next();
  size_t truncated_bytes() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace evpose
