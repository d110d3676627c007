// SPDX-License-Identifier: Apache-2.0

// A temporary directory for tests and benchmarks.
#pragma once

#include <stdlib.h>

#include <cerrno>
#include <filesystem>
#include <string>
#include <system_error>

namespace evpose {

// Creates an empty directory, and removes it with its contents at the end of the object's life. Throws
// std::filesystem::filesystem_error if the directory cannot be created.
class TemporaryDirectory {
 public:
  TemporaryDirectory() : path_(std::filesystem::temp_directory_path() / "evpose-XXXXXX") {
    if (mkdtemp(path_.data()) == nullptr) {
      throw std::filesystem::filesystem_error("the temporary directory cannot be created", path_,
                                              std::error_code(errno, std::generic_category()));
    }
  }
  ~TemporaryDirectory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TemporaryDirectory(const TemporaryDirectory&) = delete;
  TemporaryDirectory& operator=(const TemporaryDirectory&) = delete;

  const std::string& path() const { return path_; }
  std::string File(const std::string& name) const { return path_ + "/" + name; }

 private:
  std::string path_;
};

}  // namespace evpose
