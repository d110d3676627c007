// SPDX-License-Identifier: Apache-2.0

// Detects that a file has changed since it was last read.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <string>

namespace evpose::server {

// Identity and times of a file. Symbolic links are followed, so that a change of a link to a directory, as Kubernetes
// uses for secrets, is detected.
struct FileStamp {
  bool exists = false;
  dev_t device = 0;
  ino_t inode = 0;
  off_t size_bytes = 0;
  int64_t modified_ns = 0;
  int64_t changed_ns = 0;
  mode_t mode = 0;

  friend bool operator==(const FileStamp&, const FileStamp&) = default;
};

FileStamp StampOf(const std::string& path);

}  // namespace evpose::server
