// SPDX-License-Identifier: Apache-2.0

// The data directory of a server, locked against other servers.
#pragma once

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace evpose::server {

// Holds an exclusive lock on the directory until it is destroyed or the process ends.
class DataDirectory {
 public:
  // Creates the directory with access for its owner only, unless it exists, and locks it. The parent directory must
  // exist. Errors name the path: INVALID_ARGUMENT for an empty path, NOT_FOUND when the parent is missing,
  // PERMISSION_DENIED when the directory cannot be written, RESOURCE_EXHAUSTED for a full disk, FAILED_PRECONDITION
  // when the path is not a directory or another server holds the lock.
  static absl::StatusOr<std::unique_ptr<DataDirectory>> Open(const std::string& path);
  ~DataDirectory();
  DataDirectory(const DataDirectory&) = delete;
  DataDirectory& operator=(const DataDirectory&) = delete;

  std::string PathOf(const std::string& file) const { return path_ + "/" + file; }

 private:
  DataDirectory(std::string path, int lock_descriptor) : path_(std::move(path)), lock_descriptor_(lock_descriptor) {}

  const std::string path_;
  const int lock_descriptor_;
};

// Creates an empty file with access for its owner only, unless it exists. Errors: PERMISSION_DENIED, naming the path.
absl::Status MakePrivateFile(const std::string& path);

}  // namespace evpose::server
