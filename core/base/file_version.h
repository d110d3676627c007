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
  // Errors: as Of(); DATA_LOSS, without the path, if the name refers to another file or the file has changed since: the
  // bytes that were read then belong to different versions.
  absl::Status CheckUnchanged() const;

 private:
  FileVersion(std::string path, const struct stat& info) : path_(std::move(path)), info_(info) {}

  std::string path_;
  struct stat info_;
};

}  // namespace evpose
