// SPDX-License-Identifier: Apache-2.0
#include "core/base/file_version.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <fstream>

#include "core/base/temporary_directory_testing.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

TEST(FileVersionTest, AChangeIsNoticed) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("a"), other = directory.File("b");
  for (const std::string& name : {path, other}) std::ofstream(name) << "text";
  const FileVersion version = FileVersion::Of(path).value();
  EXPECT_EQ(version.CheckUnchanged(), absl::OkStatus());

  std::ofstream(path, std::ios::app) << "more";
  EXPECT_EQ(version.CheckUnchanged().code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(version.CheckUnchanged().message(), HasSubstr("its size was 4 bytes and is 8; read it again"));

  std::filesystem::resize_file(path, 4);
  std::filesystem::last_write_time(path, std::filesystem::last_write_time(path) + std::chrono::seconds(1));
  EXPECT_THAT(version.CheckUnchanged().message(), HasSubstr("it was written to"));

  std::filesystem::rename(other, path);
  EXPECT_THAT(version.CheckUnchanged().message(), HasSubstr("another file has replaced it"));

  std::filesystem::remove(path);
  EXPECT_THAT(version.CheckUnchanged().message(), HasSubstr("cannot be read"));
  EXPECT_EQ(FileVersion::Of(path).status().code(), absl::StatusCode::kUnavailable);
}

}  // namespace
}  // namespace evpose
