// SPDX-License-Identifier: Apache-2.0

// The bytes of a recording in any format: from a file, a pipe, or a file that still grows.
#pragma once

#include <sys/stat.h>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"

namespace evpose {

struct RecordingReaderOptions {
  // Whether to wait at the end of the file for more bytes until `stop` returns true. A pipe ends when its writer closes
  // it.
  bool is_following = false;
  // Called before every wait, about 100 times a second while no bytes arrive; true ends the reading without an error.
  std::function<bool()> stop;
};

class ByteSource {
 public:
  // Opens a file; `path` "-" is standard input. Errors have the path: NOT_FOUND, PERMISSION_DENIED, INVALID_ARGUMENT
  // for a directory.
  static absl::StatusOr<std::unique_ptr<ByteSource>> Open(const std::string& path,
                                                          const RecordingReaderOptions& options = {});
  // The same for an open descriptor (a pipe, a socket), which the source closes; `name` replaces the path in errors.
  static absl::StatusOr<std::unique_ptr<ByteSource>> OpenDescriptor(int descriptor, const std::string& name,
                                                                    const RecordingReaderOptions& options = {});
  ~ByteSource();
  ByteSource(const ByteSource&) = delete;
  ByteSource& operator=(const ByteSource&) = delete;

  // The next bytes, which Read() will return again: at least `num_bytes`, or all up to the end. Errors as for Read().
  absl::StatusOr<std::string_view> Peek(size_t num_bytes);
  // Continues at byte `offset` of a regular file. UNAVAILABLE with the path if that is not possible.
  absl::Status Seek(int64_t offset);
  // Removes the first bytes of those that Peek() has returned.
  void Drop(size_t num_bytes);

  // Fills `buffer` with the next bytes and returns their number, which may be smaller than the buffer; 0 at the end or
  // if `stop` returned true. Errors: DATA_LOSS if the file shrank, or without `follow` if it changed or was replaced
  // while it was read; UNAVAILABLE with path and offset if reading fails.
  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer);

  const std::string& name() const { return name_; }  // for errors
  const RecordingReaderOptions& options() const { return options_; }
  bool was_stopped() const { return is_stopped_; }
  // Whether a path leads to the same bytes again, as for a regular file that was opened by its name.
  bool can_be_reopened() const { return is_regular_ && descriptor_ != 0; }
  // Size of the file when it was opened; -1 if unknown (a pipe, a growing file).
  int64_t size_bytes() const { return is_regular_ && !options_.is_following ? opened_.st_size : -1; }

 private:
  ByteSource(int descriptor, std::string name, RecordingReaderOptions options)
      : descriptor_(descriptor), name_(std::move(name)), options_(std::move(options)) {}

  absl::StatusOr<size_t> ReadDescriptor(absl::Span<uint8_t> buffer);
  // Waits until there are bytes to read; false if `stop` returned true before.
  bool WaitForData();
  bool MustStop();
  // What was read is a recording only if the file was the same from its first byte to its last.
  absl::Status CheckUnchanged() const;
  absl::Status CheckNotShrunk() const;
  absl::Status Error(int error_number, const std::string& what) const;

  const int descriptor_;
  const std::string name_;
  const RecordingReaderOptions options_;
  struct stat opened_ = {};  // the file when it was opened
  bool is_regular_ = false;
  bool is_stopped_ = false;
  std::string peeked_;  // read, but not returned by Read()
  int64_t offset_ = 0;
};

}  // namespace evpose
