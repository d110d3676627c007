// SPDX-License-Identifier: Apache-2.0
#include "server/auth/file_stamp.h"

#include <sys/stat.h>

namespace evpose::server {
namespace {

constexpr int64_t kNanosecondsPerSecond = 1'000'000'000;

int64_t ToNanoseconds(const timespec& time) { return time.tv_sec * kNanosecondsPerSecond + time.tv_nsec; }

}  // namespace

FileStamp StampOf(const std::string& path) {
  struct stat info = {};
  if (stat(path.c_str(), &info) != 0) return {};
  return {.exists = true,
          .device = info.st_dev,
          .inode = info.st_ino,
          .size_bytes = info.st_size,
          .modified_ns = ToNanoseconds(info.st_mtim),
          .changed_ns = ToNanoseconds(info.st_ctim),
          .mode = info.st_mode};
}

}  // namespace evpose::server
