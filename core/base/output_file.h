// SPDX-License-Identifier: Apache-2.0

// A file that is written whole or not at all.
#pragma once

#include <cstdint>
#include <cstdio>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace evpose {

// Writes to a temporary name beside `path` and renames it in Commit(): nobody ever sees a half-written file under the
// name, and a file that stood there stays until then. A path that is no regular file (/dev/stdout, a pipe) is written
// directly.
class OutputFile {
 public:
  // Errors name the path: NOT_FOUND for a missing directory, PERMISSION_DENIED, INVALID_ARGUMENT for a directory.
  static absl::StatusOr<OutputFile> Create(const std::string& path);
  // Goes on with what an earlier process left half-written under the name `path`.partial: with its first `kept_bytes`.
  // Without Commit() the file stays there for the next one. Errors as Create(); INVALID_ARGUMENT for a path that is no
  // regular file; DATA_LOSS when fewer bytes are there.
  static absl::StatusOr<OutputFile> Continue(const std::string& path, uint64_t kept_bytes);
  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&& other) noexcept;
  ~OutputFile();  // without Commit(): removes the temporary file of Create()

  // Errors name the path; the first one stays, so that Commit() alone may be checked.
  absl::Status Append(std::string_view bytes);
  // What was appended is on the disk; its size.
  absl::StatusOr<uint64_t> Sync();
  // Once, last.
  absl::Status Commit();

 private:
  OutputFile() = default;
  void Discard();

  std::string path_;
  std::string temporary_path_;  // empty: written directly
  bool is_continued_ = false;
  std::FILE* file_ = nullptr;
  absl::Status status_;
};

// The whole of `contents` under `path`, or nothing.
absl::Status WriteFile(const std::string& path, std::string_view contents);

// Errors name the path: NOT_FOUND, PERMISSION_DENIED, INVALID_ARGUMENT for a directory or more than `max_bytes`.
absl::StatusOr<std::string> ReadFile(const std::string& path, size_t max_bytes);

}  // namespace evpose
