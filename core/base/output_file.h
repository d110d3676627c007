// SPDX-License-Identifier: Apache-2.0

// Files that appear under their name only when they are complete.
#pragma once

#include <cstdint>
#include <cstdio>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace evpose {

// Writes to a temporary name beside `path` and renames the file in Commit(): a reader never finds an incomplete file
// under `path`, and an older file stays there until then. A path that is not a regular file (/dev/stdout, a pipe) is
// written directly.
class OutputFile {
 public:
  // Errors name the path: NOT_FOUND for a missing directory, PERMISSION_DENIED, INVALID_ARGUMENT for a directory.
  static absl::StatusOr<OutputFile> Create(const std::string& path);
  // Resumes a file that an earlier process left incomplete as `path`.partial: keeps its first `kept_bytes` bytes, cuts
  // the rest off and appends. Without Commit() the file stays there for the next process. Errors as for Create();
  // INVALID_ARGUMENT for a path that is not a regular file; DATA_LOSS if the file has fewer bytes.
  static absl::StatusOr<OutputFile> Continue(const std::string& path, uint64_t kept_bytes);
  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&& other) noexcept;
  ~OutputFile();  // removes the temporary file of Create() unless it was committed

  // Errors have the path. Every later call returns the first error, so that it suffices to check Commit().
  absl::Status Append(std::string_view bytes);
  // Passes the appended bytes to the system, so that they are in the file if this process is killed.
  absl::Status Flush();
  // Waits until the appended bytes are on the disk, and returns the file's size in bytes.
  absl::StatusOr<uint64_t> Sync();
  // Closes the file and gives it its name. The last call.
  absl::Status Commit();
  // Removes the temporary file, also that of Continue(), so that an older file stays. The last call.
  void Remove();

  // The name under which the bytes are until Commit().
  const std::string& present_path() const { return temporary_path_.empty() ? path_ : temporary_path_; }

 private:
  OutputFile() = default;
  void Discard();

  std::string path_;
  std::string temporary_path_;  // empty if `path_` is written directly
  bool is_continued_ = false;
  std::FILE* file_ = nullptr;
  absl::Status status_;
};

// Writes `contents` as the file `path`, as OutputFile does.
absl::Status WriteFile(const std::string& path, std::string_view contents);

// The contents of a regular file. Errors have the path: NOT_FOUND, PERMISSION_DENIED, INVALID_ARGUMENT for a directory,
// a pipe or a device, which might never end, and for a file of more than `max_bytes`.
absl::StatusOr<std::string> ReadFile(const std::string& path, size_t max_bytes);
// Returns those of these errors that do not depend on the contents, for files that a library reads.
absl::Status CheckIsFile(const std::string& path);

}  // namespace evpose
