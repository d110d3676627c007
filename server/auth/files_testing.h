// SPDX-License-Identifier: Apache-2.0

// Files for tests, in a temporary directory.
#pragma once

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <string>

#include "core/base/output_file.h"

namespace evpose::server {

class TestFiles {
 public:
  TestFiles() : directory_(std::filesystem::path(testing::TempDir()) / ("evpose_files." + std::to_string(getpid()))) {
    std::filesystem::create_directories(directory_);
  }
  ~TestFiles() { std::filesystem::remove_all(directory_); }

  std::string Path(const std::string& name) const { return (directory_ / name).string(); }
  // Writes the file atomically, with access for its owner only, and returns its path.
  std::string Write(const std::string& name, const std::string& contents) const {
    EXPECT_TRUE(WriteFile(Path(name), contents).ok());
    EXPECT_EQ(chmod(Path(name).c_str(), 0600), 0);
    return Path(name);
  }

 private:
  const std::filesystem::path directory_;
};

}  // namespace evpose::server
