// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <sys/stat.h>

#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace evpose {

// Returns how a file has changed between two calls of stat(): "its size was 5 bytes and is 7"; empty if it has not.
std::string DescribeFileChange(const struct stat& before, const struct stat& now);

// The file of a name at one time: its identity, its size and the time of its last change. For files that a library
// reads; core/recordings/byte_source.h compares those that it reads itself.
class FileVersion {
 public:
  // Errors: UNAVAILABLE without the path.
  static absl::StatusOr<FileVersion> Of(const std::string& path);
  // DATA_LOSS, without the path, if another file has the name or the file has changed since: what was read of it is not
  // one file.
  absl::Status CheckUnchanged() const;

 private:
  FileVersion(std::string path, const struct stat& info) : path_(std::move(path)), info_(info) {}

  std::string path_;
  struct stat info_;
};

}  // namespace evpose
