// SPDX-License-Identifier: Apache-2.0

// The directory that a server keeps its data in, for itself.
#pragma once

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace evpose::server {

// Held by one process at a time, until it is destroyed or the process dies.
class DataDirectory {
 public:
  // Makes the directory, for its owner only, when it is not there; the one above it has to be. Errors name the path:
  // INVALID_ARGUMENT for no path, NOT_FOUND for a missing directory above, PERMISSION_DENIED for one that cannot be
  // written, FAILED_PRECONDITION for what is no directory and for one that another server holds.
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

// Makes an empty file that its owner alone may read, when there is none. Errors: PERMISSION_DENIED, naming the path.
absl::Status MakePrivateFile(const std::string& path);

}  // namespace evpose::server
